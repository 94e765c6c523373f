// A search for words that no page has finds nothing: the search of the theme would show pages with any words that differ by
// two letters. Words with one letter more, less or changed are found as before, from six letters on.
(() => {
  const Base = window.Worker, FROM = 6, NOTHING = "x".repeat(40);
  const parts = (text, config) => text.toLowerCase().split(new RegExp(config.separator)).filter(Boolean);

  /** Return true if two words become equal by changing, adding or leaving out at most one letter. */
  function near(one, other) {
    const [short, long] = one.length < other.length ? [one, other] : [other, one];
    let start = 0, end = 0;
    while (start < short.length && short[start] === long[start]) start++;
    while (end < short.length - start && short.at(-1 - end) === long.at(-1 - end)) end++;
    return long.length - start - end <= 1;
  }

  window.Worker = class extends Base {
    postMessage(message) {
      if (message.type === 0) {
        this.pages = message.data;
      } else if (message.type === 2 && typeof message.data.input === "string" && !this.finds(message.data.input)) {
        message = { type: 2, data: { ...message.data, input: NOTHING } };
      }
      super.postMessage(message);
    }

    /** Return true if a page has one of the words, or the beginning of one; or if there are no words. */
    finds(input) {
      const { config, items } = this.pages;
      this.words ??= [...new Set(items.flatMap(({ title, text, path }) =>
        parts([title, text, ...(path ?? [])].join(" ").replace(/<[^>]*>/g, " "), config)))];
      const wanted = parts(input, config);
      return wanted.length === 0 || wanted.some((word) => this.words.some((each) =>
        each.startsWith(word) || (word.length >= FROM && near(word, each))));
    }
  };
})();
