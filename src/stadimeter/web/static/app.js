// The frame of the page: its tabs, what is said on every one of them, and the view that is open.

import { api } from "./api.js";
import { ask, askedBy } from "./dialog.js";
import { old, UNITS } from "./format.js";
import { Live } from "./live_stream.js";
import { alarmsInWords, Others, OthersBar } from "./others.js";
import { drawStop } from "./stop.js";
import { Badge, Button, html, Icon, inCode, render, Select } from "./ui.js";

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
const SAID_MAX = 3;

const part = (id) => document.getElementById(id);
const live = new Live();
let session = null;
let others = null;
let said = [];
let opened = 0;

/** Say something about what was done: good news goes by itself, the rest when it was read. */
function say(words, kind = "good") {
  const each = { words, kind, number: (said.at(-1)?.number ?? 0) + 1 };
  const close = () => drawSaid(said.filter((other) => other !== each));
  drawSaid([...said.slice(1 - SAID_MAX), Object.assign(each, { close })]);
  if (kind === "good") setTimeout(close, GOOD_MS);
}

function drawSaid(list) {
  said = list;
  const line = ({ words, kind, number, close }) => html`<p key=${number} class=${`said is-${kind}`}>
    <span>${words}</span><${Button} kind="bare" label="Close" onclick=${close}><${Icon} name="close" /><//></p>`;
  render(said.map(line), part("words"));
}

const chosenUnit = () => UNITS[localStorage.getItem("unit")] ?? UNITS.m;
const route = () => VIEWS[location.hash.slice(1).split("/")[0]] ?? VIEWS.live;
const canOperate = () => session.right === "operate";

async function open() {
  const mine = ++opened;
  const view = route();
  const show = (content) => {
    const kind = view.isOfRun ? "view of-run" : "view";
    if (mine === opened) render(html`<div key=${mine} class=${kind}>${content}</div>`, part("main"));
  };
  show(null);
  document.title = `${view.name} · stadimeter`;
  drawTabs();
  drawState();
  try {
    if (view.right === "operate" && !canOperate())
      throw new Error("You are logged in to look. This page is for those who may operate.");
    const { View } = await view.load();
    show(html`<${View} ...${{ session, live, others, unit: chosenUnit(), say }} />`);
  } catch (error) {
    show(failed(error));
  }
}

const failed = (error) => html`<p class="banner is-error">${error.message}</p>`;

function drawTabs() {
  const here = VIEWS[route().within] ?? route();
  const shown = Object.entries(VIEWS).filter(([, { right, within }]) => !within && (!right || right === session.right));
  const tab = ([key, view]) => html`<a key=${key} href=${`#${key}`} class="tab"
    aria-current=${view === here ? "page" : undefined}><${Icon} name=${key} /><span>${view.name}</span></a>`;
  render(shown.map(tab), part("tabs"));
}

function drawMenu() {
  const choose = (symbol) => (localStorage.setItem("unit", symbol), open());
  const units = Object.fromEntries(Object.keys(UNITS).map((symbol) => [symbol, symbol]));
  const menu = html`
    ${!canOperate() && html`<span class="small quiet">You are logged in to look, not to operate.</span>`}
    <label class="small quiet">Lengths in<${Select} options=${units} value=${chosenUnit().symbol} choose=${choose} /></label>
    ${session.needs_password && html`<${Button} kind="bare" onclick=${logOut}>Log out<//>`}`;
  render(menu, part("menu"));
}

async function logOut() {
  await api.post("/logout").catch((error) => say(error.message, "error"));
  location.assign("/login");
}

/** What every page shows: whether the picture is live, how many alarms there are, and what cannot be overlooked. */
function drawState() {
  const { snapshot, state } = live;
  const isLive = state.status === "live" && snapshot && live.staleMs() === null;
  const count = isLive ? alarmsInWords(snapshot.rules.filter(({ is_alarm }) => is_alarm)) : "";
  const otherwise = { live: "standing still", lost: "not connected" };
  render(
    html`${isLive && snapshot.recording && html`<${Badge} kind="alarm">recording<//>`}
      ${count && html`<${Badge} kind="alarm">${count}<//>`}
      <${Badge} kind=${isLive ? "good" : "quiet"}>${isLive ? "live" : (otherwise[state.status] ?? "connecting")}<//>`,
    part("state"),
  );
  // A computer that is not set up yet begins there, unless a person has chosen a view.
  if (state.code === "no-configuration" && !location.hash && canOperate()) location.hash = "setup";
  render(banners(isLive).map(banner), part("banners"));
  if (snapshot?.run) render(snapshot.run.title ?? "", part("title"));
}

/** Each `{kind, words}`, and what one who may operate can do about it: `{act: [words, what it does]}`, or `href`. */
function banners(isLive) {
  const { snapshot, state } = live;
  if (state.status === "lost" && route() === VIEWS.setup) return []; // it needs no run, and starts one at its end
  if (state.code === "no-configuration")
    return [{ kind: "warning", words: state.words, act: ["Set it up", () => location.assign("#setup")] }];
  if (state.status === "lost")
    return [{ kind: "error", words: state.words, act: state.code === "no-run" && ["Start the run", startRun] }];
  if (live.staleMs() >= SILENT_MS)
    return [{ kind: "error", words: "Nothing comes from the run any more. What is shown is old." }];
  if (!isLive) return [];
  const { mode, reason } = snapshot.safety;
  const { trouble, mounting } = snapshot.health;
  const safe = { stopped: "Every output is at its safe value", disarmed: "Every output is at its safe value" };
  const act = { stopped: ["Release", () => letAct("release")], disarmed: ["Arm", () => letAct("arm")] };
  const confirm = mounting === "unconfirmed" && ["Confirm the mounting", () => letAct("confirm-mounting")];
  return [
    mode !== "active" && {
      kind: mode === "stopped" || mode === "stale" ? "error" : "warning",
      words: `${safe[mode] ?? "Outputs are at their safe values"}: ${reason || mode}`,
      act: act[mode],
    },
    trouble && { kind: "warning", words: trouble, act: confirm },
  ].filter(Boolean);
}

const banner = ({ kind, words, act }) => html`<p class=${`banner is-${kind}`}><span>${inCode(words)}</span>
  ${act && canOperate() && html`<${Button} onclick=${act[1]}>${act[0]}<//>`}</p>`;

/** Everything that the run tells is grey and says how old it is, while it is not of now: `.stale .of-run` and --age. */
function markAge() {
  const root = document.documentElement;
  const age = live.staleMs();
  if (age !== null) root.style.setProperty("--age", `"${old(age)}"`);
  const was = root.classList.contains("stale");
  if (root.classList.toggle("stale", age !== null) !== was) drawState();
}

const MOVES = "Outputs act at once, as the rules want them to: what moves may move off.";
const SAVES = "Its present view is saved in place of the former one. Measure a distance by tape first.";
const ACTS = {
  release: ["Release", "Release the outputs", MOVES],
  arm: ["Arm", "Arm the run", MOVES],
  "confirm-mounting": ["Confirm", "Confirm the mounting of the camera", SAVES],
};

async function letAct(op) {
  const [action, title, words] = ACTS[op];
  const send = ({ by, why }) => api.post(`outputs/${op}`, { by: by || undefined, why });
  const done = await ask({ title, words, fields: askedBy(), action, send });
  if (done) say(done.answer.words);
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
    render(failed(error), part("main"));
    setTimeout(begin, 2000);
    return;
  }
  drawMenu();
  if (canOperate()) drawStop(part("stop"));
  others = new Others(session);
  others.watch((list) => render(html`<${OthersBar} others=${list} />`, part("others")));
  window.addEventListener("hashchange", open);
  await open(); // first: what it subscribes to decides whether the stream has pictures
  live.watch(drawState);
  setInterval(drawState, 250);
  setInterval(markAge, AGE_EVERY_MS);
  live.subscribe(() => {}, { image: false }); // every view needs what it tells
  document.addEventListener("visibilitychange", markAge); // a tab that comes back shows what was when it was left
}

begin();
