// The text that is not saved yet, and what it began from: kept in the tab, so that a reload of the page loses nothing.

const KEY = "stadimeter.draft";

/** The kept draft of this configuration: `{path, text, base}`, or null. */
export function keptDraft(path) {
  try {
    const draft = JSON.parse(sessionStorage.getItem(KEY));
    return draft?.path === path ? draft : null;
  } catch {
    return null;
  }
}

/** Keep a draft; one that is as saved is forgotten. */
export function keepDraft(path, text, base) {
  try {
    if (text === base.text) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, JSON.stringify({ path, text, base }));
  } catch {
    // A browser that keeps nothing: the text is still on the page, which asks before it is left.
  }
}
