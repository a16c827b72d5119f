// Figures for people, as the terminal writes them: no more digits than ± supports, in the unit that was chosen.

export const UNKNOWN = "—";
export const UNITS = {
  m: { symbol: "m", size_m: 1, decimals: 3 },
  cm: { symbol: "cm", size_m: 0.01, decimals: 1 },
  ft: { symbol: "ft", size_m: 0.3048, decimals: 2 },
  in: { symbol: "in", size_m: 0.0254, decimals: 1 },
};

const SLACK = 1.7;

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const decimalsOf = (sigma, most) =>
  sigma > 0 ? Math.max(0, Math.min(most, -Number(sigma.toExponential(0).split("e")[1]))) : most;
const fixed = (value, decimals) => (Math.round(value * 10 ** decimals) / 10 ** decimals + 0).toFixed(decimals);

/** A distance as `{value, sigma, text}`: texts without the unit, and both with it. */
export function distance(distance_m, sigma_m, unit = UNITS.m, places = null) {
  if (!isNumber(distance_m)) return { value: UNKNOWN, sigma: "", text: UNKNOWN };
  const sigma = (isNumber(sigma_m) ? sigma_m : 0) / unit.size_m;
  const decimals = places ?? decimalsOf(sigma, unit.decimals);
  const value = fixed(distance_m / unit.size_m, decimals);
  if (!sigma) return { value, sigma: "", text: `${value} ${unit.symbol}` };
  const about = fixed(Math.max(sigma, 10 ** -unit.decimals), decimals);
  return { value, sigma: about, text: `${value} ${unit.symbol} ± ${about}` };
}

/** Distances that follow each other, by name: the last digit stays where it is until ± has clearly changed. A ± that
 *  wavers by half around a limit, as the filter's does, would have the number change its width several times a second. */
export function steadyDistances() {
  const kept = new Map();
  return (name, distance_m, sigma_m, unit) => {
    if (!(isNumber(distance_m) && sigma_m > 0)) return distance(distance_m, sigma_m, unit);
    const [fewest, wanted, most] = [SLACK, 1, 1 / SLACK].map((by) =>
      decimalsOf((sigma_m * by) / unit.size_m, unit.decimals),
    );
    const was = kept.get(name) ?? wanted;
    const places = fewest <= was && was <= most ? was : wanted;
    kept.set(name, places);
    return distance(distance_m, sigma_m, unit, places);
  };
}

export const speed = (mps, unit = UNITS.m) =>
  isNumber(mps) ? `${fixed(mps / unit.size_m, Math.min(2, unit.decimals))} ${unit.symbol}/s` : UNKNOWN;

/** Speed of approach: `closing 0.21 m/s`, `leaving …` or `steady`; one that is not twice its ± counts as none. */
export function closing(mps, sigma, unit) {
  if (!isNumber(mps)) return "";
  if (Math.abs(mps) < 0.005 || Math.abs(mps) <= 2 * (sigma ?? 0)) return "steady";
  return `${mps > 0 ? "closing" : "leaving"} ${speed(Math.abs(mps), unit)}`;
}

/** A bearing, positive to the right: `3° left` or `ahead`. */
export function bearing(rad) {
  if (!isNumber(rad)) return "";
  const degrees = Math.round((rad * 180) / Math.PI);
  return degrees ? `${Math.abs(degrees)}° ${degrees > 0 ? "right" : "left"}` : "ahead";
}

export const tilt = (rad) => (isNumber(rad) ? `tilted ${Math.round((Math.abs(rad) * 180) / Math.PI)}°` : "");
export const level = (part) => (part > 0 && part < 0.005 ? "<1 %" : `${Math.round(part * 100)} %`);

/** How long: `4 s`, `2 min`, `3 h`, `5 days`. */
export function span(seconds) {
  if (!isNumber(seconds)) return UNKNOWN;
  const [size, name] =
    seconds < 100 ? [1, "s"] : seconds < 6000 ? [60, "min"] : seconds < 172800 ? [3600, "h"] : [86400, "days"];
  return `${Math.round(Math.max(0, seconds) / size)} ${name}`;
}

/** How long ago: `1.4 s ago`, `2 min ago`. */
export const since = (seconds) => `${seconds < 10 ? `${fixed(seconds, 1)} s` : span(seconds)} ago`;

/** How old: `1 s old`, `2 min old`; never 0 s, since nobody asks about what is of now. */
export const old = (ms) => `${span(Math.max(1, ms / 1000))} old`;

/** A moment by this device's clock: the time, and the date unless it is today's. */
export function moment(unix_s) {
  if (!isNumber(unix_s)) return UNKNOWN;
  const at = new Date(unix_s * 1000);
  const time = at.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" });
  return at.toDateString() === new Date().toDateString() ? time : `${at.toLocaleDateString()} ${time}`;
}

export function size(bytes) {
  if (!isNumber(bytes)) return UNKNOWN;
  const power = bytes < 1000 ? 0 : Math.min(4, Math.floor(Math.log10(bytes) / 3));
  const value = bytes / 1000 ** power;
  return `${value < 10 && power ? value.toFixed(1) : Math.round(value)} ${["B", "kB", "MB", "GB", "TB"][power]}`;
}

const LENGTH = /(?<![\w.])(-?\d+(?:\.(\d+))?) m(\/s)?\b(?: ± (\d+\.\d+))?(?: \(-?[\d.]+ ft\))?/g;

/** A sentence of the server with each length and speed in it in a unit, to the place that it is stated to. */
export function words(sentence, unit = UNITS.m) {
  if (unit.size_m === 1) return sentence;
  return sentence.replace(LENGTH, (_, value, places = "", per = "", sigma) => {
    const step = 10 ** -places.length / unit.size_m;
    const decimals = Math.min(unit.decimals, Math.max(0, Math.floor(0.5 - Math.log10(step))));
    const about = sigma ? ` ± ${fixed(sigma / unit.size_m, decimals)}` : "";
    return `${fixed(value / unit.size_m, decimals)} ${unit.symbol}${per}${about}`;
  });
}
