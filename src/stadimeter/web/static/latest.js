// One request at a time, the newest wins.

/** Return `wish(...values)`, which does `work(signal, ...values)`. While one is under way, only the newest further wish
 *  is kept, and done next; it resolves when all is done. With `calls_off`, a newer wish ends the signal of the one that
 *  is under way. `wish.end()` does so too, and drops what waits. */
export function latest(work, { calls_off = false } = {}) {
  let next = null;
  let running = null;
  let stop = new AbortController();
  const run = async () => {
    try {
      while (next) {
        const values = next;
        next = null;
        stop = new AbortController();
        await work(stop.signal, ...values);
      }
    } finally {
      running = null;
    }
  };
  const wish = (...values) => {
    next = values;
    if (calls_off) stop.abort();
    running ??= run();
    return running;
  };
  wish.end = () => {
    next = null;
    stop.abort();
  };
  return wish;
}
