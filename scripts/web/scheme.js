// Colour scheme of the page, light or dark; it can change while the page is open.
const QUERY = '(prefers-color-scheme: dark)', scheme = matchMedia(QUERY);

// Function that returns the first value in the light scheme and the second one in the dark scheme.
export const pick = (light, dark) => () => scheme.matches ? dark : light;

// A query of its own: in Chromium a read of `matches` between the change and its event suppresses the event.
export const onScheme = call => matchMedia(QUERY).addEventListener('change', call);
