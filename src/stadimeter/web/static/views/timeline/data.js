// What the timeline shows: what the run has kept, and behind its end what this page has seen since.

import * as format from "../../format.js";

const FIGURES = ["mean_m", "sigma_m", "low_m", "high_m"];

/** The server's answer with the live values behind its end, as the chart takes them. */
export function dataOf({ from_s, step_s, count, targets, lanes, events }, { history, snapshot }) {
  const ahead_s = snapshot ? snapshot.unix_s - snapshot.now_s : 0;
  const kept = new Map(Object.entries(targets).map(([name, figures]) => [name, { ...figures }]));
  for (const [name, samples] of Object.entries(history.samples)) {
    const found = kept.get(name) ?? Object.fromEntries(FIGURES.map((key) => [key, Array(count).fill(null)]));
    const end = found.mean_m.findLastIndex((each) => each !== null) + 1;
    kept.set(
      name,
      withLive(
        found,
        samples.map(([at_s, ...rest]) => [Math.floor((at_s + ahead_s - from_s) / step_s), ...rest]),
        end,
        count,
      ),
    );
  }
  const newest_s = events.at(-1)?.unix_s ?? 0;
  const fresh = history.events.filter(({ unix_s }) => unix_s > newest_s + 0.01).toReversed();
  return {
    times: Array.from({ length: count }, (_, at) => from_s + (at + 0.5) * step_s),
    targets: Object.fromEntries(kept),
    lanes: snapshot ? lanesWith(lanes, snapshot, step_s) : lanes,
    events: [...events, ...fresh],
  };
}

function withLive(figures, samples, end, count) {
  const found = Object.fromEntries(FIGURES.map((key) => [key, [...figures[key]]]));
  const times = new Map();
  for (const [at, metres, sigma] of samples) {
    if (at < end || at >= count || metres === null) continue;
    const times_ = (times.set(at, (times.get(at) ?? 0) + 1), times.get(at));
    found.mean_m[at] = ((found.mean_m[at] ?? 0) * (times_ - 1) + metres) / times_;
    found.sigma_m[at] = sigma;
    found.low_m[at] = Math.min(found.low_m[at] ?? metres, metres);
    found.high_m[at] = Math.max(found.high_m[at] ?? metres, metres);
  }
  return found;
}

/** The state of each rule now, from where the kept ones end if they end in it. */
function lanesWith(lanes, { rules, unix_s }, step_s) {
  const kept = new Map(lanes.map(({ rule, spans }) => [rule, spans]));
  for (const { rule, status } of rules) {
    const spans = [...(kept.get(rule) ?? [])];
    const last = spans.at(-1);
    if (last?.[2] === status && last[1] > unix_s - 130 && last[1] < unix_s)
      spans[spans.length - 1] = [last[0], unix_s, status];
    else if (!last || last[1] < unix_s) spans.push([Math.max(last?.[1] ?? 0, unix_s - step_s), unix_s, status]);
    kept.set(rule, spans);
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
