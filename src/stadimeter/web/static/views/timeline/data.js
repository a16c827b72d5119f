// What the timeline shows: what the run has kept, and behind its end what this page has seen since.

import * as format from "../../format.js";

const GAP_S = 1; // samples further apart are not joined
const NOTED_S = 3; // a state that is seen again within this time has lasted
const SPANS_MAX = 500;
const FIGURES = ["mean_m", "sigma_m", "low_m", "high_m"];

/** The server's answer with the live values behind its end, as the chart takes them. */
export function dataOf({ from_s, step_s, count, targets, lanes, events }, { history, snapshot }, seen = new Map()) {
  const ahead_s = snapshot ? snapshot.unix_s - snapshot.now_s : 0;
  const kept = new Map(Object.entries(targets).map(([name, figures]) => [name, { ...figures }]));
  for (const [name, samples] of Object.entries(history.samples)) {
    const found = kept.get(name) ?? Object.fromEntries(FIGURES.map((key) => [key, Array(count).fill(null)]));
    const end = found.mean_m.findLastIndex((each) => each !== null) + 1;
    const steps = samples.map(([at_s, ...rest]) => [Math.floor((at_s + ahead_s - from_s) / step_s), ...rest]);
    kept.set(name, withLive(found, steps, end, count, GAP_S / step_s));
  }
  const newest_s = events.at(-1)?.unix_s ?? 0;
  const fresh = history.events.filter(({ unix_s }) => unix_s > newest_s + 0.5).toReversed();
  return {
    times: Array.from({ length: count }, (_, at) => from_s + (at + 0.5) * step_s),
    targets: Object.fromEntries(kept),
    lanes: lanesWith(lanes, seen),
    events: [...events, ...fresh],
  };
}

/** Samples of a recording, `[at_s, metres or null, sigma]`, as figures of equal steps. */
export function gridded(samples, count, step_s) {
  const none = Object.fromEntries(FIGURES.map((key) => [key, Array(count).fill(null)]));
  const steps = samples.map(([at_s, ...rest]) => [Math.min(count - 1, Math.floor(at_s / step_s)), ...rest]);
  return withLive(none, steps, 0, count, GAP_S / step_s);
}

/** Samples in their steps; those of a slow camera, not more than `joined` steps apart, are joined. */
function withLive(figures, samples, end, count, joined) {
  const found = Object.fromEntries(FIGURES.map((key) => [key, [...figures[key]]]));
  const times = new Map();
  let last = null;
  for (const [at, metres, sigma] of samples) {
    const isJoined = last !== null && metres !== null && at - last > 1 && at - last <= joined;
    if (isJoined) for (const key of FIGURES) found[key].fill(found[key][last], last + 1, Math.min(at, count));
    last = metres === null || at < end ? null : at;
    if (at < end || at >= count || metres === null) continue;
    const times_ = (times.set(at, (times.get(at) ?? 0) + 1), times.get(at));
    found.mean_m[at] = ((found.mean_m[at] ?? 0) * (times_ - 1) + metres) / times_;
    found.sigma_m[at] = sigma;
    found.low_m[at] = Math.min(found.low_m[at] ?? metres, metres);
    found.high_m[at] = Math.max(found.high_m[at] ?? metres, metres);
  }
  return found;
}

/** Note the state of each rule now, in spans by rule. */
export function noteStates(seen, { rules, unix_s }) {
  for (const { rule, status } of rules) {
    const spans = seen.get(rule) ?? [];
    const last = spans.at(-1);
    if (last?.[2] === status && unix_s - last[1] < NOTED_S) last[1] = unix_s;
    else spans.push([last && unix_s - last[1] < NOTED_S ? last[1] : unix_s, unix_s, status]);
    seen.set(rule, spans.slice(-SPANS_MAX));
  }
}

/** The spans that were kept, and behind their end those that were seen. */
function lanesWith(lanes, seen) {
  const kept = new Map(lanes.map(({ rule, spans }) => [rule, spans]));
  for (const [rule, spans] of seen) {
    const before = kept.get(rule) ?? [];
    const end_s = before.at(-1)?.[1] ?? 0;
    const fresh = spans.filter(([, to_s]) => to_s > end_s);
    kept.set(rule, [...before, ...fresh.map(([from_s, ...rest]) => [Math.max(from_s, end_s), ...rest])]);
  }
  return [...kept].map(([rule, spans]) => ({ rule, spans }));
}

/** What was at a moment, in words. */
export function readAt({ times, targets, lanes }, unix_s, unit) {
  const at = times.findLastIndex((each) => each <= unix_s);
  const figures = Object.entries(targets).map(
    ([name, { mean_m, sigma_m }]) =>
      `${name} ${mean_m[at] === null || at < 0 ? "not measured" : format.distance(mean_m[at], sigma_m[at], unit).text}`,
  );
  const states = lanes.map(({ rule, spans }) => {
    const span = spans.find(([from_s, to_s]) => from_s <= unix_s && unix_s < to_s);
    return span && `${rule} ${span[2]}`;
  });
  return [format.moment(unix_s), ...figures, ...states.filter(Boolean)].join(" · ");
}
