"use strict";
/* The page of `pzcap lengths`: ends of known lengths are marked in the pictures of sweeps, zoom runs and motion. The
   server keeps and saves them. */

const GRAB_PX = 12, MOVED_PX = 3, KEPT_PICTURES = 60, ENDS = { from: "one end", to: "the other end" };

const KEYS = [
  [["ArrowRight", "."], "→", "next picture; with Shift ten on", e => go(frame + (e.shiftKey ? 10 : 1))],
  [["ArrowLeft", ","], "←", "picture before; with Shift ten back", e => go(frame - (e.shiftKey ? 10 : 1))],
  [["Home"], "Home", "first picture", () => go(0)],
  [["End"], "End", "last picture", () => go(film().frames - 1)],
  [["1", "2", "3", "4", "5", "6", "7", "8", "9"], "1 to 9", "a camera", e => look(+e.key - 1, kind)],
  [["s"], "s", "its sweep", () => look(camera, "sweep")],
  [["z"], "z", "its zoom run", () => look(camera, "zoom")],
  [["m"], "m", "its motion", () => look(camera, "motion")],
  [["n"], "n", "new length", () => change("begin")],
  [["Tab"], "Tab", "the other end; with Shift the end before", e => nextEnd(e.shiftKey ? -1 : 1)],
  [["c"], "c", "the end is the same place as the mark under the mouse, a corner of two sides: takes its marks by all cameras", share],
  [["x", "Delete"], "x", "forget the end's mark by this camera", () => chosen && change("unmark", { number: chosen.number, end: chosen.end, camera: name() })],
  [["u"], "u, Ctrl-Z", "undo", () => change("undo")],
  [["U", "y", "Z"], "U, Ctrl-Y", "do again what was undone", () => change("redo")],
  [["+", "="], "+", "zoom in at the mouse", () => view.zoom(1.4, view.mouse)],
  [["-"], "-", "zoom out", () => view.zoom(1 / 1.4, view.mouse)],
  [["0"], "0", "whole picture", () => view.fit()],
  [["?", "h"], "?", "these keys", () => $("keys").open ? $("keys").close() : help()],
];
const MOUSE = [
  ["click", "mark the chosen end there"], ["drag a mark", "move it; with Shift four times slower"],
  ["drag the picture", "move the picture"], ["wheel", "zoom"], ["double click", "whole picture"],
];

let about = null, shown = null, camera = 0, kind = "sweep", frame = 0, chosen = null, drag = null, view = null, said = null;
const pictures = new Map(), places = new Map();  // pictures by address; the picture that a film was left at

/* ------------------------------------------------------------------------------------------------ server */

const LOST = "The server has ended or cannot be reached. Nothing is lost: every change was saved. " +
  "Start pzcap lengths again, and open the address that it prints.";

async function ask(path, message) {
  const body = message && { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(message) };
  let answer;
  try { answer = await fetch(path, body); } catch { tell(LOST, true); return null; }
  if (answer.ok) return answer.json();
  tell(answer.status === 403 ? LOST : await answer.text(), true);
  return null;
}

/* Changes one after the other, each made of the lengths that the one before has left. */
let queue = Promise.resolve();
function change(what, more = {}) {
  queue = queue.then(async () => {
    if (!shown) return;
    const before = shown.lengths.length, answer = await ask("lengths", { do: what, seen: shown.version, ...more });
    if (!answer) return;
    take(answer);
    if (answer.error) return tell(answer.error, true);
    if (what === "begin" && answer.lengths.length > before) { choose(before, "from"); nameIt(); }
    tell(hint());
  });
  return queue;
}

function take(answer) {
  shown = answer;
  if (chosen && chosen.number >= shown.lengths.length) chosen = null;
  if (!chosen && shown.lengths.length) chosen = { number: shown.lengths.length - 1, end: "from" };
  panel(); view.draw(); loupe();
}

async function refresh() {
  const answer = await ask("lengths");
  if (!answer) return;
  if (!shown || answer.version !== shown.version) take(answer);
  if (answer.error) tell(answer.error, true);
}

function tell(text, bad = false) { $("message").textContent = text; $("message").className = bad ? "bad" : ""; }

function hint() {
  if (!shown.lengths.length) return "n begins a length: a side of the carpet, a line of the floor, a stick. Each of its ends is marked in two cameras or more.";
  if (typing()) return "Type its name, Enter, how long it is in metres, Enter. Then click where its ends are seen.";
  const one = shown.lengths[chosen.number];
  const marked = Object.keys(ENDS).every(end => one[end].length > 1);
  if (marked && !one.lacks) return `"${one.name}" is whole. n: another length; of three, one that is wrong shows.`;
  if (marked && one.length_m === null) return `Both ends of "${one.name}" are marked; type how many metres it is long.`;
  if (!one[chosen.end].length) return `Click where ${ENDS[chosen.end]} of "${one.name}" is seen; look for it with the arrows.`;
  if (one[chosen.end].length === 1) return `Mark ${ENDS[chosen.end]} in another camera, too: with one mark it must lie on the floor. Tab: the other end.`;
  return `${count(one[chosen.end].length, "camera")} have marked ${ENDS[chosen.end]}. Tab: the other end.`;
}

/* ---------------------------------------------------------------------------------------------- pictures */

function name() { return about.cameras[camera].name; }
function film(of = camera, its = kind) { return about.cameras[of].films.find(one => one.kind === its); }

function look(to, its, at = null) {
  if (!about.cameras[to] || !about.cameras[to].films.length) return;
  if (!film(to, its)) its = about.cameras[to].films[0].kind;
  const moved = to !== camera || its !== kind;
  camera = to; kind = its;
  const place = `${camera} ${kind}`;
  if (moved || !view.placed) view.fit();
  go(at === null ? places.get(place) || 0 : at, true);
}

function go(to, force = false) {
  to = Math.min(Math.max(to, 0), film().frames - 1);
  if (to === frame && !force) return;
  frame = to; drag = null;
  places.set(`${camera} ${kind}`, frame);
  history.replaceState(null, "", `#${camera + 1}/${kind}/${frame}`);
  const time = $("time");
  time.max = film().frames - 1; time.value = frame;
  load();
  bar(); view.paint(); loupe();
}

const NOTHING = { ready: false, missing: false };
const address = (number = frame) => `picture/${camera}/${kind}/${number}.jpg`;
const picture = () => pictures.get(address()) || NOTHING;

/* One picture after the other, then the next one: whoever scrubs outruns what can be decoded. */
let asked = false;
function load() {
  if (asked) return;
  const wanted = [frame, frame + 1].filter(n => n < film().frames).map(n => address(n)).find(one => !pictures.has(one));
  if (!wanted) return;
  asked = true;
  const image = new Image();
  image.src = wanted; pictures.set(wanted, image);
  while (pictures.size > KEPT_PICTURES) pictures.delete(pictures.keys().next().value);
  image.decode().then(() => { image.ready = true; }, () => { image.missing = true; }).then(() => {
    asked = false;
    if (wanted === address()) { view.paint(); loupe(); }
    load();
  });
}

/* Marks in the picture that is shown. */
function marks() {
  if (!shown) return [];
  return shown.lengths.flatMap((one, number) => Object.keys(ENDS).flatMap(end => one[end]
    .filter(mark => mark.camera === name() && mark.video === kind && mark.frame === frame)
    .map(mark => ({ number, end, px: mark.px, name: one.name }))));
}
const isChosen = mark => chosen && mark.number === chosen.number && mark.end === chosen.end;

class View extends Pane {
  constructor() {
    super($("views"));
    this.above.addEventListener("pointercancel", () => { drag = null; this.draw(); });
    this.above.addEventListener("dblclick", () => this.fit());
  }

  get size() { return film() ? film().size : [640, 480]; }
  fit() {
    if (!this.width || !about) return;
    this.show([0, 0, ...this.size]);
    this.placed = true;
    this.paint();
  }

  paint() {
    if (!this.width || !about) return;
    this.paintPicture(picture());
    this.label.textContent = `camera ${name()}, ${kind}` + (picture().missing ? ": the picture cannot be decoded" : "") + `  ${Math.round(100 * this.scale)} %`;
    this.label.classList.toggle("bad", !!picture().missing);
    this.draw();
  }

  draw() {
    if (!this.width || !about) return;
    const pen = this.emptied(), k = this.ratio;
    pen.setTransform(k, 0, 0, k, 0, 0);
    const named = new Map();  // names by place: a corner is an end of two sides
    for (const mark of [...marks()].sort((one, other) => isChosen(one) - isChosen(other))) {
      const here = isChosen(mark), [u, v] = this.screen(here && drag && drag.at ? drag.at : mark.px), place = `${u} ${v}`;
      const style = here ? colour("clicked") : colour("left"), row = named.get(place) || 0;
      named.set(place, row + 1);
      this.cross(pen, u, v, style);
      this.text(pen, mark.name, u + 10, v - 8 - 17 * row, style);
    }
  }

  cross(pen, u, v, style) {
    for (const [width, tint] of [[4, "#000c"], [1.6, style]]) {
      pen.strokeStyle = tint; pen.lineWidth = width; pen.beginPath();
      for (const [a, b] of [[-9, -2.5], [2.5, 9]]) { pen.moveTo(u + a, v); pen.lineTo(u + b, v); pen.moveTo(u, v + a); pen.lineTo(u, v + b); }
      pen.stroke();
    }
  }

  nearest(mouse) {
    let best = null, least = GRAB_PX;
    for (const mark of marks()) {
      const [u, v] = this.screen(mark.px), far = Math.hypot(u - mouse[0], v - mouse[1]) - (isChosen(mark) ? 4 : 0);
      if (far < least) { least = far; best = mark; }
    }
    return best;
  }

  down(event) {
    if (event.button !== 0) return;
    this.above.setPointerCapture(event.pointerId);
    const mouse = this.at(event), mark = this.nearest(mouse);
    if (mark) choose(mark.number, mark.end);
    drag = { mark, from: mouse, last: mouse, at: mark ? mark.px : null, moved: false };
  }

  move(event) {
    const mouse = this.at(event);
    this.mouse = mouse;
    if (!drag) { this.above.style.cursor = this.nearest(mouse) ? "move" : "crosshair"; return loupe(); }
    const [du, dv] = [mouse[0] - drag.last[0], mouse[1] - drag.last[1]];
    drag.last = mouse;
    if (!drag.moved && Math.hypot(mouse[0] - drag.from[0], mouse[1] - drag.from[1]) < MOVED_PX) return;
    drag.moved = true;
    if (!drag.mark) { this.left += du; this.top += dv; this.paint(); }
    else {
      const slow = event.shiftKey ? 4 : 1;
      drag.at = [drag.at[0] + du / this.scale / slow, drag.at[1] + dv / this.scale / slow];
      this.draw();
    }
    loupe();
  }

  up(event) {
    if (!drag || event.button !== 0) return;
    const done = drag;
    drag = null;
    if (done.mark && done.moved) put(done.at);
    else if (!done.mark && !done.moved) put(this.pixel(this.at(event)));
  }
}

/* Mark the chosen end; the mark stays drawn where it was put until the server has it. */
function put([x, y]) {
  if (!chosen) return tell("n begins a length; then click where its ends are seen", true);
  if (!picture().ready) return tell("this picture is not shown yet; click once it is", true);  // what is seen is another
  const [w, h] = view.size;
  if (x < -0.5 || y < -0.5 || x >= w - 0.5 || y >= h - 0.5) return tell("that is outside the picture", true);
  const px = [x, y].map(one => Math.round(100 * one) / 100), mark = { camera: name(), video: kind, frame, px };
  shown.lengths[chosen.number][chosen.end] = [...shown.lengths[chosen.number][chosen.end].filter(one => one.camera !== mark.camera), mark];
  view.draw();
  change("mark", { number: chosen.number, end: chosen.end, mark });
}

function share() {
  const mark = view.nearest(view.mouse);
  if (!chosen || !mark || isChosen(mark)) return tell("put the mouse over a mark of another length first", true);
  change("share", { ...chosen, other: mark.number, its: mark.end });
}

/* The pixels under the mouse, or around the chosen end's mark in this picture. */
function loupe() {
  const canvas = $("loupe"), pen = canvas.getContext("2d"), image = picture(), mark = marks().find(isChosen);
  const at = drag && drag.at ? drag.at : view.above.matches(":hover") ? view.pixel(view.mouse) : mark ? mark.px : null;
  pen.fillStyle = "#000"; pen.fillRect(0, 0, canvas.width, canvas.height);
  if (!at || !image.ready) return;
  const zoom = 10, w = canvas.width / zoom, h = canvas.height / zoom;
  pen.imageSmoothingEnabled = false;
  pen.drawImage(image, at[0] + 0.5 - w / 2, at[1] + 0.5 - h / 2, w, h, 0, 0, canvas.width, canvas.height);
  view.cross(pen, canvas.width / 2, canvas.height / 2, colour("clicked"));
  view.text(pen, `${at[0].toFixed(1)}, ${at[1].toFixed(1)}`, 6, canvas.height - 8, "#fff");
}

/* ------------------------------------------------------------------------------------------------- panel */

function bar() {
  const choice = (text, here, action) => { const made = element([here ? "button.here" : "button", text]); made.onclick = () => { made.blur(); action(); }; return made; };
  $("cameras").replaceChildren(...about.cameras.map((one, n) => choice(one.name, n === camera, () => look(n, kind))));
  $("kinds").replaceChildren(...about.cameras[camera].films.map(one => choice(one.kind, one.kind === kind, () => look(camera, one.kind))));
  $("where").textContent = `picture ${frame} of ${film().frames - 1}`;
}

function choose(number, end) {
  chosen = { number, end };
  panel(); view.draw(); tell(hint());
  $("lengths").children[number]?.scrollIntoView({ block: "nearest" });
}

function nextEnd(way) {
  if (!shown.lengths.length) return;
  const ends = 2 * shown.lengths.length, at = chosen ? 2 * chosen.number + (chosen.end === "to") : -1;
  const to = (at + way + ends) % ends;
  choose(to >> 1, to % 2 ? "to" : "from");
}

function panel() {
  $("undo").disabled = !shown.can_undo; $("redo").disabled = !shown.can_redo;
  const typed = document.activeElement && document.activeElement.closest(".length");  // what is being typed stays
  if (!typed) fill($("lengths"), shown.lengths.map(card));
  else [...$("lengths").children].forEach((old, n) => { if (old !== typed && shown.lengths[n]) old.replaceWith(card(shown.lengths[n], n)); });
  const all = shown.lengths.length, begun = shown.lengths.filter(one => one.lacks).length;
  $("saved").textContent = (begun ? `${count(all - begun, "length")} of ${all} in lengths.json; what is only begun is kept as well.` : all ? "All of them stand in lengths.json. When you have marked them all, end pzcap lengths: Ctrl-C in its terminal." : "") +
    (about.has_object ? " This capture has a calibration object: it says how long a metre is, and lengths are not used." : "");
}
const count = (n, what) => `${n} ${what}${n === 1 ? "" : "s"}`;

const FIELDS = {
  name: ["name", "its name, as the notes of a run call it"], length_m: ["length", "how long it is, in metres"],
  sigma_m: ["known to", "to how many millimetres that is known: 68 of 100 readings are off by less"],
};

/* The name of the length that was begun last is typed next: letters must not be taken for keys. */
function nameIt() { into($("lengths").lastElementChild.querySelector("input")); }
function into(input) { input.focus(); input.select(); }
const typing = () => !!document.activeElement?.closest(".length input");

function field(number, what, value, kinds, scale = 1) {
  const made = element([`input.${kinds}`]);
  made.value = value === null ? "" : scale === 1 ? value : +(value * scale).toFixed(3);
  made.setAttribute("aria-label", what);
  [made.placeholder, made.title] = FIELDS[what];
  made.onchange = () => {
    const text = made.value.trim().replace(",", "."), given = what === "name" ? made.value : text === "" ? null : Number(text) / scale;
    if (Number.isNaN(given)) return tell(`"${made.value}" is no number`, true);
    change("tell", { number, what, value: given });
  };
  made.onfocus = () => { if (!chosen || chosen.number !== number) { chosen = { number, end: "from" }; view.draw(); } };
  made.onblur = () => setTimeout(() => { panel(); if (!typing() && $("message").className !== "bad") tell(hint()); });
  made.onkeydown = event => {
    if (event.key === "Enter" && what === "name") into(made.closest(".length").querySelector("input[aria-label=length_m]"));
    else if (event.key === "Enter" || event.key === "Escape") made.blur();
    event.stopPropagation();
  };
  return made;
}

function card(one, number) {
  const here = chosen && chosen.number === number, remove = element(["button", "Remove"]);
  remove.tabIndex = -1;  // not between the name and the length
  remove.onclick = () => change("remove", { number });
  const ends = Object.keys(ENDS).flatMap(end => {
    const button = element([here && chosen.end === end ? "button.end here" : "button.end", `${ENDS[end]}: ${one[end].length ? `marked by ${count(one[end].length, "camera")}` : "not marked"}`]);
    button.onclick = () => { button.blur(); choose(number, end); };
    return [button, ...one[end].map(mark => markOf(mark, number, end))];
  });
  return element([here ? "div.length here" : "div.length",
    ["div.row", field(number, "name", one.name, "name"), remove],
    ["div.row", field(number, "length_m", one.length_m, "short"), "m, to", field(number, "sigma_m", one.sigma_m, "short", 1000), "mm"],
    ...ends,
    one.lacks ? ["div.lacks", one.lacks] : ["div.whole", "saved in lengths.json"]]);
}

function markOf(mark, number, end) {
  const there = element(["a", `camera ${mark.camera}, ${mark.video} ${mark.frame}`]), gone = element(["a", "forget"]);
  there.onclick = () => { choose(number, end); look(about.cameras.findIndex(one => one.name === mark.camera), mark.video, mark.frame); };
  gone.onclick = () => change("unmark", { number, end, camera: mark.camera });
  return element(["div.one", there, gone]);
}

/* ------------------------------------------------------------------------------------------ hand and keys */

window.addEventListener("keydown", event => {
  if (!shown || event.target.closest?.("dialog") && event.key !== "?") return;
  const held = event.ctrlKey || event.metaKey;
  if (event.altKey || (held && !["z", "y", "Z"].includes(event.key))) return;
  if (event.key === "Enter" && event.target.closest?.("button, a")) return;
  const pressed = held && event.key === "z" ? "u" : event.key, key = KEYS.find(([names]) => names.includes(pressed));
  if (key) { event.preventDefault(); key[3](event); }
});
$("undo").onclick = () => change("undo");
$("redo").onclick = () => change("redo");
$("begin").onclick = () => change("begin");
$("help").onclick = help;
function help() { $("keys").showModal(); $("keys").scrollTop = 0; }
for (const button of document.querySelectorAll("header button, #begin")) button.addEventListener("click", () => button.blur());
$("time").oninput = () => go(+$("time").value);
$("time").onchange = () => $("time").blur();
window.addEventListener("focus", () => { if (shown) refresh(); });
fill($("keylist"), [...KEYS.map(([, keys, does]) => ["div", ["kbd", keys], ["span", does]]), ...MOUSE.map(([does, what]) => ["div", ["kbd", does], ["span", what]])]);

async function start() {
  about = await ask("about");
  if (!about) return;
  document.title = `${about.name} · pzcap lengths`;
  $("name").textContent = about.name; $("name").title = about.folder;
  const [, to, its, at] = location.hash.match(/^#(\d+)\/(\w+)\/(\d+)$/) || [];
  const first = about.cameras.findIndex(one => one.films.length);
  view = new View();
  look(to && about.cameras[to - 1]?.films.length ? to - 1 : first, its || "sweep", at ? +at : null);
  await refresh();
  if (shown && !$("message").textContent) tell(hint());
}

/* What a test, or a script of one's own, has to know: where a pixel stands on the screen, and the state. */
window.lengths = {
  screenOf(x, y) { const box = view.above.getBoundingClientRect(), [u, v] = view.screen([x, y]); return [box.left + u, box.top + v]; },
  state: () => ({ shown, chosen, camera, kind, frame, message: $("message").textContent }),
  ready: () => !!(shown && view && view.placed && picture().ready),
};
start();
