// What is wrong with a page as it is drawn now, in words; each function returns a list that ought to be empty.
// Put into the page by tests/support/page.py.

(() => {
  const TOLERANCE_PX = 1;
  const CONTRAST_MIN = 4.5;
  const ACTIONS = "a[href], button, input, select, textarea, summary, [tabindex]:not([tabindex='-1'])";

  const told = (element) => {
    const words = (element.getAttribute("aria-label") || element.textContent || "")
      .trim()
      .replace(/\s+/g, " ")
      .slice(0, 60);
    const kind = [element.tagName.toLowerCase(), ...element.classList].join(".");
    return `${kind} "${words}"`;
  };
  const isShown = (element) =>
    element.checkVisibility({ opacityProperty: true, visibilityProperty: true }) && !element.closest(".sr");
  const scrolls = (element, axis) => ["auto", "scroll"].includes(getComputedStyle(element)[axis]);
  const isInside = (element, does) => {
    for (let each = element.parentElement; each && each !== document.documentElement; each = each.parentElement)
      if (does(each)) return true;
    return false;
  };
  const inScroller = (element) => isInside(element, (each) => scrolls(each, "overflowX"));
  const isClippedDecoration = (element) =>
    !element.textContent.trim() &&
    isInside(element, (each) => ["hidden", "clip"].includes(getComputedStyle(each).overflowX));

  function* texts(root = document.body) {
    const walker = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
      const element = node.parentElement;
      if (node.data.trim() && isShown(element) && !element.closest("script, style, option, noscript"))
        yield [node, element];
    }
  }

  function boxes(node) {
    const range = document.createRange();
    range.selectNodeContents(node);
    return [...range.getClientRects()].filter((box) => box.width > 0);
  }

  /** Elements and words that reach out of the screen or their panel, and words that are clipped. */
  function cutOff() {
    const width = document.documentElement.clientWidth;
    const faults = [];
    if (document.scrollingElement.scrollWidth > width + TOLERANCE_PX)
      faults.push(`the page scrolls sideways: ${document.scrollingElement.scrollWidth} px in ${width}`);
    for (const element of document.body.querySelectorAll("*")) {
      if (
        !isShown(element) ||
        inScroller(element) ||
        element.closest(".skip") ||
        element.ownerSVGElement ||
        isClippedDecoration(element)
      )
        continue;
      const box = element.getBoundingClientRect();
      if (box.width && (box.right > width + TOLERANCE_PX || box.left < -TOLERANCE_PX))
        faults.push(`beyond the screen: ${told(element)}`);
    }
    for (const [node, element] of texts()) {
      const panel = element.closest("svg, .panel, dialog, .banner");
      if (panel && !inScroller(element)) {
        const around = panel.getBoundingClientRect();
        if (boxes(node).some((box) => box.right > around.right + TOLERANCE_PX || box.left < around.left - TOLERANCE_PX))
          faults.push(`out of its panel: "${node.data.trim().slice(0, 60)}"`);
      }
      if (element.closest("[aria-hidden=true]")) continue; // follows something else that scrolls
      const style = getComputedStyle(element);
      const hides = (axis) => ["hidden", "clip"].includes(style[axis]);
      if (hides("overflowX") && element.scrollWidth > element.clientWidth + TOLERANCE_PX)
        faults.push(`clipped: ${told(element)}`);
      if (hides("overflowY") && element.scrollHeight > element.clientHeight + TOLERANCE_PX)
        faults.push(`clipped below: ${told(element)}`);
    }
    return [...new Set(faults)];
  }

  const ink = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  function rgba(colour) {
    ink.clearRect(0, 0, 1, 1);
    ink.fillStyle = colour;
    ink.fillRect(0, 0, 1, 1);
    const [red, green, blue, alpha] = ink.getImageData(0, 0, 1, 1).data;
    return [red, green, blue, alpha / 255];
  }
  const over = (front, back) => [0, 1, 2].map((each) => front[each] * front[3] + back[each] * (1 - front[3])).concat(1);
  const luminance = (colour) => {
    const [red, green, blue] = colour
      .slice(0, 3)
      .map((each) => (each / 255 <= 0.04045 ? each / 255 / 12.92 : ((each / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
  };
  const contrast = (one, other) => {
    const [dark, light] = [luminance(one), luminance(other)].sort((a, b) => a - b);
    return (light + 0.05) / (dark + 0.05);
  };
  function behind(element) {
    const layers = [];
    for (let each = element; each; each = each.parentElement) {
      const colour = rgba(getComputedStyle(each).backgroundColor);
      if (colour[3] > 0) layers.push(colour);
      if (colour[3] === 1) break;
    }
    return layers.reduceRight((back, front) => over(front, back), rgba("white"));
  }

  /** Words, and signs that stand for words, with less contrast than 4.5 to what is behind them. */
  function faint() {
    const faults = new Set();
    const judge = (colour, element, what) => {
      const back = behind(element);
      const ratio = contrast(over(rgba(colour), back), back);
      if (ratio < CONTRAST_MIN) faults.add(`${ratio.toFixed(2)}: ${what}`);
    };
    for (const [, element] of texts())
      if (!element.closest("svg") && !element.closest(".old"))
        judge(getComputedStyle(element).color, element, told(element));
    for (const [, element] of texts())
      if (element.closest("svg text, text")) judge(getComputedStyle(element).fill, element, told(element));
    for (const element of document.querySelectorAll(
      "input:not([type=range], [type=checkbox], [type=radio], [type=color]), textarea, select",
    )) {
      if (!isShown(element)) continue;
      judge(getComputedStyle(element).color, element, told(element));
      if (element.placeholder)
        judge(getComputedStyle(element, "::placeholder").color, element, `placeholder of ${told(element)}`);
    }
    for (const element of document.querySelectorAll(".mark, .badge, .banner")) {
      if (isShown(element))
        judge(getComputedStyle(element, "::before").color, element, `the sign before ${told(element)}`);
    }
    return [...faults];
  }

  /** What can be operated, without a name that a screen reader could say. */
  function unnamed() {
    const named = (element) =>
      element.getAttribute("aria-label") ||
      element.getAttribute("aria-labelledby") ||
      element.title ||
      element.textContent.trim() ||
      [...(element.labels ?? [])].some((label) => label.textContent.trim());
    return actions()
      .filter((element) => !named(element))
      .map(told);
  }

  function actions() {
    return [...document.querySelectorAll(ACTIONS)].filter(
      (element) => isShown(element) && !element.disabled && element.getAttribute("tabindex") !== "-1",
    );
  }

  /** Call after each Tab: notes where the focus is, and whether it can be seen. Returns whether it was there before. */
  const visited = new Set();
  const names = new Set(); // an element may be made anew once the focus has left it
  const unseen = new Set();
  function visit() {
    const element = document.activeElement;
    if (!element || element === document.body || visited.has(element)) return visited.has(element);
    visited.add(element);
    names.add(told(element));
    const frames = [element, element.parentElement, element.parentElement?.parentElement];
    if (frames.every((each) => !each || getComputedStyle(each).outlineStyle === "none")) unseen.add(told(element));
    return false;
  }

  /** What no Tab came to (of radio buttons with one name, one is enough), and where the focus was not to be seen. */
  function unreachable() {
    const groups = new Set([...visited].filter((element) => element.type === "radio").map((element) => element.name));
    const missed = actions().filter(
      (element) =>
        !visited.has(element) && !names.has(told(element)) && !(element.type === "radio" && groups.has(element.name)),
    );
    return [
      ...missed.map((element) => `no Tab comes to ${told(element)}`),
      ...[...unseen].map((each) => `no sign of the focus on ${each}`),
    ];
  }

  /** What is too small for a thumb: less than 24 px either way, or less than 44 px both ways. */
  function tooSmall() {
    return actions()
      .filter((element) => {
        const target = element.closest("label") ?? element;
        const { width, height } = target.getBoundingClientRect();
        const isInText = element.tagName === "A" && element.closest("p, li, dd, td");
        return (
          width &&
          !isInText &&
          !element.closest(".skip, svg") &&
          (Math.min(width, height) < 24 || Math.max(width, height) < 44)
        );
      })
      .map(told);
  }

  const said = (what, faults) => faults.map((each) => `${what}: ${each}`);
  const all = () => [
    ...cutOff(),
    ...said("too faint", faint()),
    ...said("no name", unnamed()),
    ...said("too small", tooSmall()),
  ];
  window.pageChecks = { all, visit, unreachable };
})();
