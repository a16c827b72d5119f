// The frame of the page: its tabs, what is said on every one of them, and the view that is open.

import { api } from "./api.js";
import { ask } from "./dialog.js";
import { h, icon, inCode, keyed, replace, write } from "./dom.js";
import { old, span, UNITS } from "./format.js";
import { Live } from "./live_stream.js";
import { drawOthers, Others, stands } from "./others.js";
import { stopButton } from "./stop.js";

const VIEWS = {
  live: { name: "Live", isOfRun: true, load: () => import("./views/live/index.js") },
  timeline: { name: "Timeline", load: () => import("./views/timeline/index.js") },
  setup: { name: "Set-up", load: () => import("./views/setup/index.js"), right: "operate" },
  certificate: { name: "Certificate", within: "setup", load: () => import("./views/certificate.js"), right: "operate" },
  edit: { name: "Edit", load: () => import("./views/edit/index.js"), right: "operate" },
  recordings: { name: "Recordings", load: () => import("./views/recordings.js") },
  alarms: { name: "Alarms", isOfRun: true, load: () => import("./views/alarms.js") },
};
const GOOD_MS = 6000;
const SILENT_MS = 2500;
const AGE_EVERY_MS = 100;

const part = (id) => document.getElementById(id);
const live = new Live();
let session = null;
let others = null;
let takeDown = () => {};
let opened = 0;

/** Say something about what was done: good news goes by itself, the rest when it was read. */
function say(words, kind = "good") {
  const close = h(
    "button",
    { type: "button", class: "button bare", "aria-label": "Close", onclick: () => said.remove() },
    icon("close"),
  );
  const said = h("p", { class: `said is-${kind}` }, h("span", null, words), close);
  part("words").replaceChildren(...[...part("words").children].slice(-2), said);
  if (kind === "good") setTimeout(() => said.remove(), GOOD_MS);
}

function chosenUnit() {
  return UNITS[localStorage.getItem("unit")] ?? UNITS.m;
}

function route() {
  return VIEWS[location.hash.slice(1).split("/")[0]] ?? VIEWS.live;
}

async function open() {
  const mine = ++opened;
  const view = route();
  takeDown();
  takeDown = () => {};
  for (const tab of part("tabs").children) {
    if (tab.view === (VIEWS[view.within] ?? view)) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  document.title = `${view.name} · stadimeter`;
  drawState();
  const root = h("div", { class: view.isOfRun ? "view of-run" : "view" });
  replace(part("main"), root);
  try {
    if (view.right === "operate" && session.right !== "operate")
      throw new Error("You are logged in to look. This page is for those who may operate.");
    const { mount } = await view.load();
    if (mine === opened) takeDown = mount(root, { session, api, live, others, unit: chosenUnit(), say }) ?? takeDown;
  } catch (error) {
    replace(root, h("p", { class: "banner is-error" }, error.message));
  }
}

function drawTabs() {
  const shown = Object.entries(VIEWS).filter(([, { right, within }]) => !within && (!right || right === session.right));
  replace(
    part("tabs"),
    shown.map(([key, view]) =>
      Object.assign(h("a", { href: `#${key}`, class: "tab" }, icon(key), h("span", null, view.name)), { view }),
    ),
  );
}

function drawMenu() {
  const unit = h(
    "select",
    { onchange: () => (localStorage.setItem("unit", unit.value), open()) },
    Object.keys(UNITS).map((symbol) =>
      h("option", { value: symbol, selected: symbol === chosenUnit().symbol }, symbol),
    ),
  );
  const leave =
    session.needs_password && h("button", { type: "button", class: "button bare", onclick: logOut }, "Log out");
  const toLook =
    session.right !== "operate" && h("span", { class: "small quiet" }, "You are logged in to look, not to operate.");
  replace(part("menu"), toLook, h("label", { class: "small quiet" }, "Lengths in", unit), leave);
}

async function logOut() {
  await api.post("/logout").catch((error) => say(error.message, "error"));
  location.assign("/login");
}

/** What every page shows: whether the picture is live, how many alarms there are, and what cannot be overlooked. */
function drawState() {
  const { snapshot, state } = live;
  const isLive = state.status === "live" && snapshot && live.staleMs() === null;
  const active = isLive ? snapshot.rules.filter((rule) => rule.is_alarm && stands(rule)) : [];
  const badges = [
    isLive && snapshot.recording && { key: "rec", kind: "alarm", words: "recording" },
    active.length && {
      key: "alarms",
      kind: "alarm",
      words: `${active.length} ${active.length === 1 ? "alarm" : "alarms"}`,
    },
    {
      key: "state",
      kind: isLive ? "good" : "quiet",
      words: isLive
        ? "live"
        : state.status === "live"
          ? "standing still"
          : state.status === "lost"
            ? "not connected"
            : "connecting",
    },
  ];
  keyed(
    part("state"),
    badges.filter(Boolean),
    (each) => each.key,
    () => badge(),
  );
  // A computer that is not set up yet begins there, unless a person has chosen a view.
  if (state.code === "no-configuration" && !location.hash && session.right === "operate") location.hash = "setup";
  keyed(part("banners"), banners(isLive), (each) => each.key, banner);
  if (snapshot?.run) write(part("title"), snapshot.run.title ?? "");
}

function badge() {
  const element = h("span");
  element.update = ({ kind, words }) => {
    element.className = `badge is-${kind}`;
    write(element, words);
  };
  return element;
}

function banners(isLive) {
  const { snapshot, state } = live;
  if (state.status === "lost" && route() === VIEWS.setup) return []; // it needs no run, and starts one at its end
  if (state.code === "no-configuration")
    return [{ key: "new", kind: "warning", words: state.words, offersSetUp: session.right === "operate" }];
  if (state.status === "lost")
    return [
      {
        key: `lost ${state.code}`,
        kind: "error",
        words: state.words,
        offersStart: session.right === "operate" && state.code === "no-run",
      },
    ];
  if (live.staleMs() >= SILENT_MS)
    return [
      {
        key: "silent",
        kind: "error",
        words: `Nothing has come from the run for ${span(live.staleMs() / 1000)}. What is shown is old.`,
      },
    ];
  if (!isLive) return [];
  const { safety, health } = snapshot;
  const offersConfirm = session.right === "operate" && health.mounting === "unconfirmed";
  const isStopped = safety.mode === "stopped";
  const isDisarmed = safety.mode === "disarmed";
  return [
    isStopped && {
      key: "stopped",
      kind: "error",
      words: `Every output is at its safe value: ${safety.reason}`,
      offersRelease: session.right === "operate",
    },
    isDisarmed && {
      key: "disarmed",
      kind: "warning",
      words: `Every output is at its safe value: ${safety.reason}`,
      offersArm: session.right === "operate",
    },
    safety.mode !== "active" &&
      !isStopped &&
      !isDisarmed && {
        key: "safety",
        kind: safety.mode === "stale" ? "error" : "warning",
        words: `Outputs are at their safe values: ${safety.reason || safety.mode}`,
      },
    health.trouble && { key: "trouble", kind: "warning", words: health.trouble, offersConfirm },
  ].filter(Boolean);
}

/** Everything that the run tells is grey and says how old it is, while it is not of now: `.stale .of-run` and --age. */
function markAge() {
  const root = document.documentElement;
  const age = live.staleMs();
  if (age !== null) root.style.setProperty("--age", `"${old(age)}"`);
  if (root.classList.toggle("stale", age !== null) !== markAge.was) drawState();
  markAge.was = age !== null;
}

function banner({ offersStart, offersSetUp, offersRelease, offersArm, offersConfirm }) {
  const words = h("span");
  const start = offersStart && h("button", { type: "button", class: "button", onclick: startRun }, "Start the run");
  const release =
    offersRelease && h("button", { type: "button", class: "button", onclick: () => letAct(RELEASE) }, "Release");
  const arm = offersArm && h("button", { type: "button", class: "button", onclick: () => letAct(ARM) }, "Arm");
  const confirm =
    offersConfirm &&
    h("button", { type: "button", class: "button", onclick: () => letAct(CONFIRM) }, "Confirm the mounting");
  const setUp = offersSetUp && h("a", { href: "#setup", class: "button" }, "Set it up");
  const element = h("p", { class: "banner" }, words, start, setUp, release, arm, confirm);
  element.update = (each) => {
    element.className = `banner is-${each.kind}`;
    if (words.said !== each.words) replace(words, inCode((words.said = each.words)));
  };
  return element;
}

const RELEASE = { path: "outputs/release", title: "Release the outputs", action: "Release" };
const ARM = { path: "outputs/arm", title: "Arm the run", action: "Arm" };
const MOVES = "Outputs act at once, as the rules want them to: what moves may move off.";
const CONFIRM = {
  path: "outputs/confirm-mounting",
  title: "Confirm the mounting of the camera",
  action: "Confirm",
  words: "Its present view is saved in place of the former one. Measure a distance by tape first.",
};

async function letAct({ path, title, action, words = MOVES }) {
  const fields = [
    { name: "why", label: "Why", placeholder: "may be left empty", maxLength: 200 },
    {
      name: "by",
      label: "Your name",
      value: localStorage.getItem("name") ?? "",
      placeholder: "may be left empty",
      maxLength: 60,
    },
  ];
  const given = await ask({ title, words, fields, action });
  if (!given) return;
  try {
    say((await api.post(path, { by: given.by || undefined, why: given.why })).words);
  } catch (error) {
    say(error.message, "error");
  }
}

async function startRun() {
  try {
    const answer = await api.post("run/start");
    say(answer?.words ?? "The run was started.");
  } catch (error) {
    say(error.message, "error");
  }
  live.retry();
}

async function begin() {
  try {
    session = await api.get("session");
  } catch (error) {
    replace(part("main"), h("p", { class: "banner is-error" }, error.message));
    setTimeout(begin, 2000);
    return;
  }
  drawTabs();
  drawMenu();
  replace(part("stop"), session.right === "operate" && stopButton(api));
  others = new Others(api, session);
  others.watch((list) => drawOthers(part("others"), list));
  window.addEventListener("hashchange", open);
  await open(); // first: what it subscribes to decides whether the stream has pictures
  live.watch(drawState);
  live.subscribe(drawState, { image: false });
  setInterval(drawState, 500);
  setInterval(markAge, AGE_EVERY_MS);
  document.addEventListener("visibilitychange", markAge); // a tab that comes back shows what was when it was left
}

begin();
