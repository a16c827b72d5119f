// What changed between two texts, line by line.

import { html } from "./ui.js";

const CONTEXT = 2; // lines shown around each change
const CELLS_MAX = 4_000_000; // beyond this, the whole middle counts as changed
const TAGS = { "+": "ins", "-": "del", " ": "div" };

/** Lines of both texts in order: `{sign: " " | "-" | "+", text}`. */
function difference(before, after) {
  const [a, b] = [before.split("\n"), after.split("\n")];
  let start = 0;
  while (start < a.length && start < b.length && a[start] === b[start]) start += 1;
  let end = 0;
  while (end < a.length - start && end < b.length - start && a.at(-1 - end) === b.at(-1 - end)) end += 1;
  const middle = between(a.slice(start, a.length - end), b.slice(start, b.length - end));
  return [...a.slice(0, start).map(line(" ")), ...middle, ...a.slice(a.length - end).map(line(" "))];
}

const line = (sign) => (text) => ({ sign, text });

/** The longest common subsequence of lines, walked from its table. */
function between(a, b) {
  if (a.length * b.length > CELLS_MAX) return [...a.map(line("-")), ...b.map(line("+"))];
  const width = b.length + 1;
  const common = new Uint32Array((a.length + 1) * width);
  for (let i = a.length - 1; i >= 0; i -= 1)
    for (let j = b.length - 1; j >= 0; j -= 1)
      common[i * width + j] =
        a[i] === b[j]
          ? common[(i + 1) * width + j + 1] + 1
          : Math.max(common[(i + 1) * width + j], common[i * width + j + 1]);
  const lines = [];
  let [i, j] = [0, 0];
  while (i < a.length && j < b.length) {
    if (a[i] === b[j]) lines.push(line(" ")(a[i])), (i += 1), (j += 1);
    else if (common[(i + 1) * width + j] >= common[i * width + j + 1]) lines.push(line("-")(a[i])), (i += 1);
    else lines.push(line("+")(b[j])), (j += 1);
  }
  return [...lines, ...a.slice(i).map(line("-")), ...b.slice(j).map(line("+"))];
}

/** The changes with a few lines around them; where there are none, `none` says so. */
export function Difference({ before, after, label, none }) {
  const lines = difference(before, after);
  const near = new Set();
  for (const [at, { sign }] of lines.entries())
    if (sign !== " ") for (let each = at - CONTEXT; each <= at + CONTEXT; each += 1) near.add(each);
  if (!near.size) return html`<p class="quiet">${none}</p>`;
  const gap = html`<div class="gap">⋯</div>`;
  const shown = ({ sign, text }, at) =>
    near.has(at) ? html`<${TAGS[sign]}>${sign} ${text}<//>` : near.has(at - 1) && gap;
  return html`<pre class="difference" tabindex="0" role="region" aria-label=${label}>${lines.map(shown)}</pre>`;
}
