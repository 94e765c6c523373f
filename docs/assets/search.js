// The search of the theme needs all words of a query in one section, and shows pages with any words that differ by two
// letters. Here a query that is no title keeps its rarest words that one section has, without words such as "how"; if no
// section has any of its words, nothing is found. Words with one letter more, less or changed are found as before, from six
// letters on.
(() => {
  const Base = window.Worker, FROM = 6, NOTHING = "x".repeat(40);
  const PLAIN = new Set(("a an and are as at be by can do does for from has have how i in into is it its me much my of on or " +
    "should than that the this to want what when where which while who why will with without you your").split(" "));
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
      } else if (message.type === 2 && typeof message.data.input === "string") {
        message = { type: 2, data: { ...message.data, input: this.reduced(message.data.input) } };
      }
      super.postMessage(message);
    }

    /** Return the words of a query that one section has together, the rarest first considered. */
    reduced(input) {
      const { config, items } = this.pages;
      this.sections ??= items.map(({ title, text, path }) =>
        [...new Set(parts([title, text, ...(path ?? [])].join(" ").replace(/<[^>]*>/g, " "), config))]);
      const all = parts(input, config), rest = all.filter((word) => !PLAIN.has(word));
      this.titles ??= items.map(({ title }) => parts(title, config));
      if (this.titles.some((words) => all.every((word) => words.some((each) => each.startsWith(word))))) return input;
      const wanted = rest.length ? rest : all;
      const found = new Map(wanted.map((word) => [word, this.having(word)]));
      const known = wanted.filter((word) => found.get(word).size);
      if (known.length === 0) return NOTHING;
      let together = null;
      const kept = new Set();
      for (const word of [...known].sort((one, other) => found.get(one).size - found.get(other).size)) {
        const both = [...found.get(word)].filter((each) => together === null || together.has(each));
        if (both.length) {
          together = new Set(both);
          kept.add(word);
        }
      }
      return kept.size === all.length ? input : wanted.filter((word) => kept.has(word)).join(" ");
    }

    /** Return the sections with a word, or with the beginning of one, as a set of indices. */
    having(word) {
      const sections = (fits) => new Set(this.sections.flatMap((words, index) => (words.some(fits) ? [index] : [])));
      const found = sections((each) => each.startsWith(word));
      return found.size || word.length < FROM ? found : sections((each) => near(word, each));
    }
  };
})();
