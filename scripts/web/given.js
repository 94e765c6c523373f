// What the page is given before its script runs: data of the episodes, stage (null without WebGL), events of a live page.
export const given = { data: null, stage: null, source: null };
