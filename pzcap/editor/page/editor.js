"use strict";
/* The page of `pzcap edit`. It draws and listens; poses are solved, kept and saved by the server. */

const GRAB_PX = 13, MOVED_PX = 3, POINTER_PX = 2.5, LOUPE_PX = 74, KEPT_PICTURES = 60;

const KEYS = [
  [["ArrowRight", "."], "→", "next frame; with Shift ten on", e => go(frame + (e.shiftKey ? 10 : 1))],
  [["ArrowLeft", ","], "←", "frame before; with Shift ten back", e => go(frame - (e.shiftKey ? 10 : 1))],
  [["Home"], "Home", "first frame", () => go(0)],
  [["End"], "End", "last frame", () => go(about.frames - 1)],
  [["]"], "]", "next keyframe", () => toKey(1)],
  [["["], "[", "keyframe before", () => toKey(-1)],
  [["n"], "n", "best frame to pose next", () => overview.suggested.length && go(overview.suggested[0].frame)],
  [["Tab"], "Tab", "next joint; with Shift the one before", e => choose(e.shiftKey ? -1 : 1)],
  [["p", "Enter"], "p, Enter", "pin the joint where it is, in the view under the mouse", pin],
  [["v"], "v", "joint not visible in the view under the mouse, or visible again", () => ofView("hide")],
  [["x"], "x", "forget the joint's click in the view under the mouse", () => ofView("unclick")],
  [["X"], "X", "forget the joint's clicks in all views", () => chosen !== null && say("unclick", { handle: chosen })],
  [["u", "z"], "u, Ctrl-Z", "undo, without end", () => step("undo")],
  [["U", "y", "Z"], "U, Ctrl-Y", "do again what was undone", () => step("redo")],
  [["k"], "k", "make this frame a keyframe, or none", () => shown && say("key", { key: !shown.is_key })],
  [["m"], "m", "exchange left and right: the arms or legs of the chosen joint", () => exchange(limbsOf(chosen))],
  [["M"], "M", "exchange left and right of the whole body", () => exchange("whole")],
  [["g"], "g", "fit the pose to the silhouettes; what was clicked counts, too", () => { if (shown) { tell("fitting to the silhouettes"); say("fit", {}); } }],
  [["t"], "t", "begin anew from the tracked pose", () => begin("tracker")],
  [["i"], "i", "begin anew between the keyframes around", () => begin("between")],
  [["c"], "c", "begin anew as a copy of the nearest keyframe", () => begin("copied")],
  [["a"], "a", "begin anew standing", () => begin("standing")],
  [["r"], "r", "solve again from here; Esc stops it", () => say("solve", {})],
  [["1", "2", "3", "4", "5", "6", "7", "8", "9"], "1 to 9", "one view alone, or all again", e => alone(+e.key - 1)],
  [["f"], "f", "zoom all views to the body", () => views.forEach(view => view.fit(true))],
  [["0"], "0", "whole pictures", () => views.forEach(view => view.fit(false))],
  [["+", "="], "+", "zoom in at the mouse", () => over && over.zoom(1.4, over.mouse)],
  [["-"], "-", "zoom out", () => over && over.zoom(1 / 1.4, over.mouse)],
  [["s"], "s", "silhouettes on or off", () => toggle("silhouettes")],
  [["b"], "b", "body on or off", () => toggle("body")],
  [["l"], "l", "loupe: while dragging, always, never", () => { show.loupe = (show.loupe + 1) % 3; redraw(); tell(`loupe: ${["while dragging", "always", "never"][show.loupe]}`); }],
  [["w"], "w", "the pose as it was before it was solved again, on or off", () => toggle("before")],
  [["Escape"], "Esc", "let go of a drag; stop solving", escape],
  [["?", "h"], "?", "these keys", () => $("keys").open ? $("keys").close() : help()],
];
const MOUSE = [
  ["drag a joint", "the body follows; let go to keep it"], ["Shift while dragging", "four times slower"],
  ["click a joint", "choose it"], ["right click", "put the chosen joint there; Alt-click as well"], ["wheel", "zoom"],
  ["drag the picture", "move it"], ["double click", "zoom to the body"], ["click in the line of time", "go to that frame"],
];

let about = null, overview = null, shown = null, frame = 0, chosen = null, over = null, drag = null, hovered = null;
let silhouettes = null, solving = null, socket = null, lost = false;
const show = { silhouettes: true, body: true, before: true, loupe: 0 };
const views = [], pictures = new Map();

/* ------------------------------------------------------------------------------------------------ server */

const LOST = "The server has ended or cannot be reached. Nothing is lost: every change was saved. " +
  "Start pzcap edit again, and open the address that it prints.";
const LOOKS = ["show", "silhouettes"];  // asked again on connecting; the others change something

function connect() {
  socket = new WebSocket(`ws://${location.host}/live`);
  socket.onmessage = event => hear(JSON.parse(event.data));
  socket.onopen = () => { lost = false; if (about) tell("connected again"); };
  socket.onclose = () => {
    if (!lost) tell(LOST, true);
    lost = true; drag = null; setTimeout(connect, 1500);
  };
}

function send(message) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  else if (!LOOKS.includes(message.do)) tell(`Nothing was changed now. ${LOST}`, true);
}

function say(what, more) {
  if (shown) send({ do: what, frame, seen: shown.version, ...more });
}

function step(what) { if (overview) send({ do: what, seen: overview.version }); }

function hear(message) {
  if (message.about) {
    const first = !about;
    about = message.about;
    document.title = `${about.name} · pzcap edit`;
    $("name").textContent = about.name; $("name").title = about.folder;
    if (first) { build(); tell("Drag a joint to where it is seen, then in a second view. ? shows the keys."); }
    frame = Math.min(Math.max(+(location.hash.slice(1) || 0) || 0, 0), about.frames - 1);
    go(frame, true);
  }
  if (message.overview) {
    const fresh = message.overview.difference;
    overview = message.overview;
    if (!shown && !location.hash && overview.suggested.length && !overview.keys.length) go(overview.suggested[0].frame);
    panel(); timeline();
    if (fresh) $("difference").classList.add("fresh");
  }
  if (message.shown && message.shown.frame === frame) {
    const before = shown;
    shown = message.shown;
    if (!before || before.frame !== frame) arrived(before);
    if ($("message").textContent === "fitting to the silhouettes") tell("fitted");
    panel(); redraw();
  }
  if (message.dragged && drag && message.frame === frame) dragged(message);
  if (message.silhouettes && message.frame === frame) {
    silhouettes = message.silhouettes.map(pathOf); redraw();
  }
  if (message.go !== undefined && message.go !== frame) go(message.go);
  if (message.error) { tell(message.error, true); if (drag && drag.waiting) drag.waiting = false; }
  if (message.done) tell(message.done);
  if (message.solving !== undefined) {
    solving = message.solving;
    if (solving) tell(`solving: ${solving[0]} of ${solving[1]} frames; Esc stops it`);
    $("solve").disabled = !!solving;
  }
}

function tell(text, bad = false) { $("message").textContent = text; $("message").className = bad ? "bad" : ""; }

/* ------------------------------------------------------------------------------------------------ frames */

function go(to, force = false) {
  to = Math.min(Math.max(to, 0), about.frames - 1);
  if (to === frame && !force) return;
  frame = to; drag = null; silhouettes = null;
  if (shown && shown.frame !== frame) shown = { ...shown, stale: true };
  history.replaceState(null, "", `#${frame}`);
  send({ do: "show", frame });
  ask();
  views.forEach(view => view.paint());
  heading(); timeline();
}

let later = 0;
function arrived(before) {
  views.forEach(view => { if (view.placed && before) view.keepUp(before); else view.fit(true); });
  clearTimeout(later);
  if (show.silhouettes) later = setTimeout(() => send({ do: "silhouettes", frame }), 120);
}

const NOTHING = { ready: false, missing: false };
const nameOf = (number, camera) => `frame/${number}/${camera}.jpg`;
const have = number => views.every(view => picture(number, view.number) !== NOTHING);

function picture(number, camera) {
  const name = nameOf(number, camera), image = pictures.get(name);
  if (!image) return NOTHING;
  pictures.delete(name); pictures.set(name, image);
  return image;
}

/* The pictures of one frame after those of another: whoever scrubs outruns what can be decoded. */
let asked = null;
function ask() {
  if (asked !== null) return;
  asked = !have(frame) ? frame : frame + 1 < about.frames && !have(frame + 1) ? frame + 1 : null;
  if (asked === null) return;
  const number = asked;
  Promise.all(views.map(view => load(number, view))).then(() => { asked = null; ask(); });
}

async function load(number, view) {
  const image = new Image(), name = nameOf(number, view.number);
  image.src = name;
  pictures.set(name, image);
  while (pictures.size > KEPT_PICTURES) pictures.delete(pictures.keys().next().value);
  await image.decode().then(() => { image.ready = true; }, () => { image.missing = true; });  // beside the page's own thread
  if (number === frame) view.paint();
}

/* ------------------------------------------------------------------------------------------------- views */

function pathOf(lines) {
  const path = new Path2D();
  for (const line of lines) {
    line.forEach(([x, y], n) => n ? path.lineTo(x, y) : path.moveTo(x, y));
    path.closePath();
  }
  return path;
}

class View extends Pane {
  constructor(number) {
    super($("views"));
    this.number = number;
    this.follows = "body";  // what stays in sight from frame to frame: the body whole, or where it was zoomed to
    this.above.addEventListener("pointercancel", () => escape());
    this.above.addEventListener("pointerleave", () => { if (over === this && !drag) { over = null; hovered = null; this.box.classList.remove("over"); redraw(); } });
    this.above.addEventListener("dblclick", e => { if (this.nearest(this.at(e)) === null) this.fit(true); });
  }

  get size() { const image = picture(frame, this.number); return image.ready ? [image.naturalWidth, image.naturalHeight] : about.sizes[this.number] || [640, 480]; }

  /* Of the body in the picture, and beside it as far as it is large; null where it is not there. */
  extent(of) {
    const [w, h] = this.size;
    const seen = of.handles[this.number].filter(p => p && p[0] > -w && p[0] < 2 * w && p[1] > -h && p[1] < 2 * h);
    if (!seen.length) return null;
    const across = seen.map(p => p[0]), down = seen.map(p => p[1]);
    return [Math.min(...across), Math.min(...down), Math.max(...across), Math.max(...down)];
  }

  /* Another frame than that of `before`: the body stays in sight. */
  keepUp(before) {
    if (!this.width || this.follows === "nothing") return;
    if (this.follows === "body") {
      const body = this.extent(shown);
      if (!body) return;
      const [u0, v0] = this.screen([body[0], body[1]]), [u1, v1] = this.screen([body[2], body[3]]);
      const share = Math.max((u1 - u0) / this.width, (v1 - v0) / this.height);
      if (Math.min(u0, v0) < 0 || u1 > this.width || v1 > this.height || share < 0.4) this.fit(true);
      return;
    }
    const [was, is] = [before, shown].map(one => this.middle(one));
    if (!was || !is) return;
    this.left -= (is[0] - was[0]) * this.scale; this.top -= (is[1] - was[1]) * this.scale;
    this.paint();
  }

  /* Of what is looked at: the chosen joint where it is in sight, else the body. */
  middle(of) {
    const points = of.handles[this.number], one = chosen === null ? null : points[chosen];
    const [u, v] = one ? this.screen(one) : [-1, -1];
    if (one && (of === shown ? this.near : this.near = u > 0 && v > 0 && u < this.width && v < this.height)) return one;
    const body = this.extent(of);
    return body && [(body[0] + body[2]) / 2, (body[1] + body[3]) / 2];
  }

  fit(toBody) {
    if (!this.width) return;
    const [w, h] = this.size;
    let [x0, y0, x1, y1] = [0, 0, w, h];
    const body = toBody && shown && !shown.stale ? this.extent(shown) : null;
    this.follows = toBody ? "body" : "nothing";
    if (body) {
      [x0, y0, x1, y1] = body;
      const margin = 0.18 * Math.max(x1 - x0, y1 - y0) + 4;
      x0 -= margin; x1 += margin; y0 -= margin; y1 += margin;
    }
    this.show([x0, y0, x1, y1]);
    this.placed = !!(shown && !shown.stale);
    this.paint();
  }

  zoom(factor, mouse) { this.follows = "place"; super.zoom(factor, mouse); }

  paint() {
    if (!this.width || !about) return;
    const image = picture(frame, this.number);
    this.paintPicture(image);
    const found = shown && !shown.stale ? shown.found[this.number] : true;
    this.label.textContent = `camera ${about.cameras[this.number]}` + (image.missing ? ": no picture" : found ? "" : ": not located in this frame") + `  ${Math.round(100 * this.scale)} %`;
    this.label.classList.toggle("bad", !found || !!image.missing);
    this.draw();
  }

  draw() {
    if (!this.width || !about) return;
    const pen = this.emptied(), k = this.ratio;
    if (!shown || shown.stale) return;
    this.inPicture(pen);
    if (show.silhouettes && silhouettes) this.stroke(pen, silhouettes[this.number], "#ff3df5", 1.6, [5, 4]);
    const now = drag && drag.drawn ? drag.drawn : shown;
    if (show.body) this.stroke(pen, pathOf(now.outlines[this.number]), "#ffffffb0", 1.1);
    pen.setTransform(k, 0, 0, k, 0, 0);
    if (show.before && shown.before) this.bones(pen, shown.before[this.number], 0.8, colour("was"));
    if (now.lines && drag.view !== this) this.line(pen, now.lines[this.number]);
    if (show.body) this.bones(pen, now.handles[this.number], 1);
    this.clicks(pen, now);
    if (show.body) this.knobs(pen, now);
    this.loupe(pen, now);
  }

  inPicture(pen) { const s = this.scale * this.ratio; pen.setTransform(s, 0, 0, s, (this.left + this.scale / 2) * this.ratio, (this.top + this.scale / 2) * this.ratio); }

  stroke(pen, path, style, width, dash = []) {
    pen.strokeStyle = style; pen.lineWidth = width / this.scale; pen.setLineDash(dash.map(d => d / this.scale));
    pen.stroke(path); pen.setLineDash([]);
  }

  line(pen, points) {
    if (!points.length) return;
    pen.strokeStyle = colour("clicked"); pen.lineWidth = 1.6; pen.setLineDash([9, 5]); pen.beginPath();
    points.forEach((p, n) => { const [u, v] = this.screen(p); n ? pen.lineTo(u, v) : pen.moveTo(u, v); });
    pen.stroke(); pen.setLineDash([]);
  }

  bones(pen, handles, alpha, style = null) {
    pen.globalAlpha = alpha; pen.lineWidth = style ? 1.5 : 2.2; pen.lineCap = "round";
    handles.forEach((point, n) => {
      const parent = about.parents[n];
      if (parent < 0 || !point || !handles[parent]) return;
      const [u, v] = this.screen(point), [a, b] = this.screen(handles[parent]);
      pen.strokeStyle = style || tint(n); pen.beginPath(); pen.moveTo(a, b); pen.lineTo(u, v); pen.stroke();
    });
    pen.globalAlpha = 1;
  }

  clicks(pen, now) {
    for (const [handle, camera, x, y, , off] of now.clicks) {
      if (camera !== this.number) continue;
      const [u, v] = this.screen([x, y]), point = now.handles[camera][handle];
      pen.strokeStyle = colour("clicked"); pen.lineWidth = 1.4;
      pen.beginPath(); pen.moveTo(u - 5, v - 5); pen.lineTo(u + 5, v + 5); pen.moveTo(u + 5, v - 5); pen.lineTo(u - 5, v + 5); pen.stroke();
      if (point && off * this.scale > 3) {
        const [a, b] = this.screen(point), focus = handle === (drag ? drag.handle : chosen);
        pen.strokeStyle = colour("bad"); pen.beginPath(); pen.moveTo(u, v); pen.lineTo(a, b); pen.stroke();
        if (focus) this.text(pen, `${off.toFixed(1)} px`, u + 8, v + 16, colour("bad"));
      } else if (handle === (drag ? drag.handle : chosen)) this.text(pen, `${off.toFixed(1)} px`, u + 8, v + 16, colour("clicked"));
    }
  }

  knobs(pen, now) {
    const hidden = new Set(shown.hidden.filter(([, c]) => c === this.number).map(([h]) => h));
    const clicked = new Set(now.clicks.filter(c => c[1] === this.number).map(c => c[0]));
    const elsewhere = new Set(now.clicks.map(c => c[0]));
    now.handles[this.number].forEach((point, n) => {
      if (!point) return;
      const [u, v] = this.screen(point), big = n === chosen || (hovered === n && over === this);
      const r = big ? 6.5 : n < about.joints ? 4.5 : 3.5;
      pen.beginPath(); pen.arc(u, v, r, 0, 7);
      if (hidden.has(n)) { pen.strokeStyle = "#9aa3"; pen.lineWidth = 1.2; pen.setLineDash([2, 2]); pen.stroke(); pen.setLineDash([]); return; }
      pen.fillStyle = clicked.has(n) ? colour("clicked") : elsewhere.has(n) ? tint(n) : "#10131899"; pen.fill();
      pen.strokeStyle = "#000"; pen.lineWidth = 3; pen.stroke();
      pen.strokeStyle = big ? "#fff" : tint(n); pen.lineWidth = 1.7; pen.stroke();
      if (big) this.text(pen, about.handles[n], u + 10, v - 8, "#fff");
    });
  }

  loupe(pen, now) {
    if (over !== this || show.loupe === 2 || (show.loupe === 0 && !(drag && drag.moved))) return;
    const image = picture(frame, this.number), at = drag && drag.at ? drag.at : this.pixel(this.mouse), R = LOUPE_PX;
    if (!image.ready) return;
    const [u, v] = this.screen(at), zoom = Math.max(Math.min(4, 6 * this.scale), 2.5 * this.scale);
    const aside = (at, length) => {  // away from the body, where there is room
      const way = at < length / 2 ? -1 : 1, far = at + 2.4 * way * R;
      return at + 1.4 * R * (far > 0 && far < length ? way : -way);
    };
    const cu = aside(u, this.width), cv = aside(v, this.height);
    pen.save(); pen.beginPath(); pen.arc(cu, cv, R, 0, 7); pen.fillStyle = "#000"; pen.fill(); pen.clip();
    pen.imageSmoothingEnabled = false;
    pen.drawImage(image, at[0] + 0.5 - R / zoom, at[1] + 0.5 - R / zoom, 2 * R / zoom, 2 * R / zoom, cu - R, cv - R, 2 * R, 2 * R);
    now.handles[this.number].forEach((point, n) => {
      if (!point || (drag && n === drag.handle)) return;
      pen.strokeStyle = tint(n); pen.lineWidth = 1.5; pen.beginPath();
      pen.arc(cu + (point[0] - at[0]) * zoom, cv + (point[1] - at[1]) * zoom, 4, 0, 7); pen.stroke();
    });
    pen.strokeStyle = colour("clicked"); pen.lineWidth = 1; pen.beginPath();
    for (const [a, b] of [[-R, -5], [5, R]]) { pen.moveTo(cu + a, cv); pen.lineTo(cu + b, cv); pen.moveTo(cu, cv + a); pen.lineTo(cu, cv + b); }
    pen.stroke(); pen.restore();
    pen.strokeStyle = "#fff"; pen.lineWidth = 1.5; pen.beginPath(); pen.arc(cu, cv, R, 0, 7); pen.stroke();
  }

  nearest(mouse) {
    if (!shown || shown.stale || !show.body) return null;
    const hidden = new Set(shown.hidden.filter(([, c]) => c === this.number).map(([h]) => h));
    let best = null, least = GRAB_PX;
    shown.handles[this.number].forEach((point, n) => {
      if (!point || hidden.has(n)) return;
      const [u, v] = this.screen(point), far = Math.hypot(u - mouse[0], v - mouse[1]) - (n === chosen ? 4 : 0);
      if (far < least) { least = far; best = n; }
    });
    return best;
  }

  down(event) {
    this.above.setPointerCapture(event.pointerId);
    const mouse = this.at(event);
    this.mouse = mouse;
    if (event.button === 2 || (event.altKey && event.button === 0)) {
      if (chosen === null) return tell("choose a joint first: click it, or Tab", true);
      say("drop", { handle: chosen, camera: this.number, ...this.clickAt(this.pixel(mouse)) });
      return;
    }
    const handle = event.button === 0 ? this.nearest(mouse) : null;
    drag = { view: this, handle, from: mouse, last: mouse, at: this.pixel(mouse), moved: false, waiting: false, next: null, drawn: null, number: 0 };
    if (handle !== null) { chosen = handle; panel(); redraw(); }
  }

  move(event) {
    const mouse = this.at(event);
    if (!drag) {
      const near = this.nearest(mouse), changed = over !== this || near !== hovered;
      if (over && over !== this) over.box.classList.remove("over");
      over = this; this.box.classList.add("over"); hovered = near; this.mouse = mouse;
      this.above.style.cursor = near === null ? "grab" : "pointer";
      if (changed) redraw(); else if (show.loupe === 1) this.draw();
      return;
    }
    if (drag.view !== this) return;
    over = this;
    const [du, dv] = [mouse[0] - drag.last[0], mouse[1] - drag.last[1]];
    drag.last = mouse; this.mouse = mouse;
    if (!drag.moved && Math.hypot(mouse[0] - drag.from[0], mouse[1] - drag.from[1]) < MOVED_PX) return;
    if (drag.handle === null) { drag.moved = true; this.follows = "place"; this.left += du; this.top += dv; this.paint(); return; }
    if (event.shiftKey && drag.moved) drag.at = [drag.at[0] + du / this.scale / 4, drag.at[1] + dv / this.scale / 4];
    else drag.at = this.pixel(mouse);
    drag.moved = true;
    this.follow(); this.draw();
  }

  clickAt([x, y]) { return { x, y, sigma: Math.min(Math.max(POINTER_PX / this.scale, 1), 100) }; }

  follow() {
    const ask = { do: "drag", frame, handle: drag.handle, camera: this.number, ...this.clickAt(drag.at) };
    if (drag.waiting) { drag.next = ask; return; }
    drag.waiting = true; drag.sent = performance.now();
    send(ask);
  }

  up() {
    const done = drag;
    if (!done) return;
    if (done.handle !== null && done.moved) {
      say("drop", { handle: done.handle, camera: this.number, ...this.clickAt(done.at) });
      if (done.drawn) shown = { ...shown, handles: done.drawn.handles, outlines: done.drawn.outlines, clicks: done.drawn.clicks };
    }
    drag = null; redraw();
  }
}

function dragged(message) {
  drag.drawn = message.dragged; drag.waiting = false;
  $("speed").textContent = `answered in ${Math.round(performance.now() - drag.sent)} ms (solved in ${message.dragged.ms})`;
  if (drag.next) { const next = drag.next; drag.next = null; drag.waiting = true; drag.sent = performance.now(); send(next); }
  redraw();
}

let wanted = false;
function redraw() {
  if (wanted) return;
  wanted = true;
  requestAnimationFrame(() => { wanted = false; views.forEach(view => view.draw()); });
}

function tint(handle) {
  const name = about.handles[handle];
  return colour(name.startsWith("left") ? "left" : name.startsWith("right") ? "right" : "middle");
}

const LEGEND = [
  ["left", "", "left"], ["right", "", "right"], ["middle", "", "trunk, head"], ["#ffffff", "", "outline of the body"],
  ["#ff3df5", "dashed", "silhouette in the footage"], ["clicked", "dashed", "where a dragged joint can be"],
  ["clicked", "knob", "clicked in this view"], ["was", "", "before it was solved again"],
];

function build() {
  fill($("legend"), LEGEND.map(([name, kind, what]) => {
    const mark = document.createElement("i");
    mark.className = kind; mark.style.color = name.startsWith("#") ? name : colour(name);
    return ["li", mark, what];
  }));
  about.cameras.forEach((_, number) => views.push(new View(number)));
  alone(-1);
  for (const [, keys, what] of KEYS) row(keys, what);
  for (const [mouse, what] of MOUSE) row(mouse, what);
  function row(keys, what) {
    const line = document.createElement("div"), kbd = document.createElement("kbd"), text = document.createElement("span");
    kbd.textContent = keys; text.textContent = what; line.append(kbd, text); $("keylist").append(line);
  }
}

let single = -1;
function alone(number) {
  if (number >= views.length) return;
  single = number === single ? -1 : number;
  views.forEach((view, n) => { view.box.style.display = single < 0 || n === single ? "" : "none"; });
  const columns = single < 0 ? Math.ceil(Math.sqrt(views.length)) : 1;
  $("views").style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
  $("views").style.gridAutoRows = "minmax(0, 1fr)";
}

/* ------------------------------------------------------------------------------------------------ panel */

function heading() {
  $("where").textContent = `frame ${frame} of ${about.frames - 1}   ${about.timecodes[frame]}`;
  const state = $("state");
  if (!shown || shown.stale) { state.textContent = "…"; state.className = "pill"; return; }
  const count = shown.clicks.length, work = count ? `, ${count} click${count > 1 ? "s" : ""}` : "";
  state.textContent = shown.is_key ? `keyframe, saved${work}` : shown.clicks.length ? `draft${work}: not sure enough yet` : shown.told_origin;
  state.className = `pill ${shown.is_key ? "key" : shown.clicks.length ? "draft" : ""}`;
  $("key").textContent = shown.is_key ? "No keyframe" : "Make keyframe";
}

function panel() {
  if (!about) return;
  heading();
  if (overview) {
    $("undo").disabled = !overview.can_undo; $("redo").disabled = !overview.can_redo;
    fill($("next"), overview.suggested.map(one => ["li", link(`frame ${one.frame}`, one.frame), ` ${one.why}`]));
    $("keyframes").replaceChildren(...overview.keys.flatMap(key => [link(`${key}`, key), " "]));
    if (!overview.keys.length) $("keyframes").textContent = overview.by_keypoints ? "none by hand; the body was tracked from a detector's keypoints" : "none yet";
    const change = overview.difference;
    $("difference").replaceChildren();
    if (change) {
      fill($("difference"), [
        ["h2", "Solved again"],
        ["p", `frames ${change.first} to ${change.last}: tracked in ${change.tracked} of ${change.last - change.first + 1}; joints to ${change.sigma_after_mm ?? "?"} mm` +
          (change.sigma_before_mm === null ? "" : `, before ${change.sigma_before_mm} mm`)],
        ["p", change.known_before ? `joints have moved by ${change.mean_mm} mm on average, most ${change.worst_mm} mm: ${change.worst}` : "they had not been tracked before"],
      ]);
    }
  }
  if (!shown || shown.stale) return;
  const sure = shown.sigma_mm.length ? worst(shown.sigma_mm) : null;
  $("pose").textContent = `from: ${shown.told_origin}` + (sure === null ? "; there is no body in this frame" : `; least sure: ${about.handles[sure]}, ${long(shown.sigma_mm[sure])}`);
  fill($("notes"), shown.notes.map(note => ["li", note]));
  $("chosen").textContent = chosen === null ? "No joint chosen" : about.handles[chosen] + (shown.sigma_mm.length ? ` (to ${long(shown.sigma_mm[chosen])})` : "");
  const rows = [];
  if (chosen !== null) {
    rows.push(["tr", ["th", "camera"], ["th", "clicked"], ["th", "misses by"]]);
    about.cameras.forEach((name, camera) => {
      const click = shown.clicks.find(c => c[0] === chosen && c[1] === camera);
      const hidden = shown.hidden.some(([h, c]) => h === chosen && c === camera);
      rows.push(["tr", ["td", name], ["td", click ? `to ${click[4].toFixed(1)} px` : hidden ? "not visible" : "–"], ["td.n", click ? `${click[5].toFixed(1)} px` : ""]]);
    });
  }
  fill($("joint"), rows);
}

function long(mm) { return mm < 1000 ? `${mm} mm` : `${(mm / 1000).toFixed(1)} m`; }
function worst(sigma) { return sigma.indexOf(Math.max(...sigma.slice(0, about.joints))); }

function link(text, to) {
  const made = document.createElement("a");
  made.textContent = text; made.tabIndex = 0; if (to === frame) made.className = "here";
  made.onclick = () => go(to);
  return made;
}

function timeline() {
  const canvas = $("time"), ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = 70;
  if (!overview || !about || !width) return;
  canvas.width = Math.round(width * ratio); canvas.height = height * ratio;
  const pen = canvas.getContext("2d"), n = about.frames, x = f => 8 + (width - 16) * (f + 0.5) / n, base = 52;
  pen.scale(ratio, ratio); pen.clearRect(0, 0, width, height);
  pen.fillStyle = "#14161a"; pen.fillRect(8, 6, width - 16, base - 6);
  const tall = mm => mm < 0 ? 0 : Math.min(Math.log10(1 + mm) / 3, 1) * (base - 6);
  const wide = Math.max((width - 16) / n, 1);
  overview.sigma_mm.forEach((mm, f) => {
    if (mm < 0) { pen.fillStyle = "#3a2226"; pen.fillRect(x(f) - wide / 2, 6, wide, base - 6); return; }
    pen.fillStyle = mm > 100 ? "#c2504f" : mm > 30 ? "#b98a3a" : "#3f7f55"; pen.fillRect(x(f) - wide / 2, base - tall(mm), wide, tall(mm));
  });
  const change = overview.difference;
  if (change && change.known_before) {
    pen.strokeStyle = colour("was"); pen.lineWidth = 1.5; pen.beginPath();
    change.moved_mm.forEach((mm, k) => { const v = base - tall(mm); k ? pen.lineTo(x(change.first + k), v) : pen.moveTo(x(change.first), v); });
    pen.stroke();
  }
  pen.fillStyle = "#d5dae2"; pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  for (const mm of [10, 100]) { const v = base - tall(mm); pen.fillRect(8, v, width - 16, 0.5); pen.strokeStyle = "#000c"; pen.lineWidth = 3; pen.strokeText(`${mm} mm`, 11, v - 2); pen.fillText(`${mm} mm`, 11, v - 2); }
  const caption = overview.sigma_mm.some(mm => mm >= 0) ? "least sure joint of each frame" : "no frame has been tracked yet";
  pen.strokeText(caption, width - 12 - pen.measureText(caption).width, 17); pen.fillText(caption, width - 12 - pen.measureText(caption).width, 17);
  overview.suggested.forEach((one, k) => { pen.fillStyle = "#8ec5ff"; pen.fillText(`${k + 1}`, x(one.frame) - 3, 67); });
  for (const f of overview.touched) { pen.fillStyle = colour("clicked"); pen.fillRect(x(f) - 1, base, 2, 4); }
  for (const f of overview.keys) { pen.fillStyle = "#4be07a"; pen.beginPath(); pen.moveTo(x(f), base - 2); pen.lineTo(x(f) - 5, base + 8); pen.lineTo(x(f) + 5, base + 8); pen.fill(); }
  pen.fillStyle = "#fff"; pen.fillRect(x(frame) - 0.75, 2, 1.5, base + 6);
}

/* ------------------------------------------------------------------------------------------ hand and keys */

function toKey(way) {
  const keys = overview.keys.filter(key => way > 0 ? key > frame : key < frame);
  if (keys.length) go(way > 0 ? keys[0] : keys[keys.length - 1]);
}
function choose(way) {
  const count = about.handles.length;
  chosen = chosen === null ? (way > 0 ? 0 : count - 1) : (chosen + way + count) % count;
  panel(); redraw();
}
function ofView(what) {
  if (chosen === null) return tell("choose a joint first: click it, or Tab", true);
  if (!over) return tell("put the mouse over a view first", true);
  say(what, { handle: chosen, camera: over.number });
}
function pin() {
  if (chosen === null || !over || !shown || shown.stale) return ofView("");
  const point = shown.handles[over.number][chosen];
  if (point) say("drop", { handle: chosen, camera: over.number, ...over.clickAt(point) });
}
function limbsOf(handle) {
  const name = handle === null ? "" : about.handles[handle];
  return /elbow|wrist|fingertip|shoulder/.test(name) ? "arms" : /hip|knee|ankle|toe|heel/.test(name) ? "legs" : null;
}
function exchange(limbs) {
  if (limbs === null) return tell("choose a joint of an arm or a leg first; M exchanges the whole body", true);
  say("exchange", { limbs });
}
function begin(origin) { say("begin", { origin }); }
function toggle(what) {
  show[what] = !show[what];
  if (what === "silhouettes" && show.silhouettes && !silhouettes) send({ do: "silhouettes", frame });
  redraw();
}
function escape() {
  if (drag && drag.moved && drag.handle !== null) { send({ do: "cancel", frame }); drag = null; redraw(); }
  else { drag = null; if (solving) send({ do: "stop" }); }
}

window.addEventListener("keydown", event => {
  if (!about || event.target.closest?.("dialog") && event.key !== "?") return;
  const held = event.ctrlKey || event.metaKey;
  if (event.altKey || (held && !["z", "y", "Z"].includes(event.key))) return;
  if (event.key === "Enter" && event.target.closest?.("button, a")) return event.target.tagName === "A" && event.target.click();
  if (event.key === "z" && !held) return;
  const key = KEYS.find(([names]) => names.includes(event.key));
  if (key) { event.preventDefault(); key[3](event); }
});
$("undo").onclick = () => step("undo");
$("redo").onclick = () => step("redo");
$("key").onclick = () => shown && say("key", { key: !shown.is_key });
$("solve").onclick = () => say("solve", {});
$("help").onclick = help;
function help() { $("keys").showModal(); $("keys").scrollTop = 0; }
for (const button of document.querySelectorAll("header button")) button.addEventListener("click", () => button.blur());
{
  const scrub = event => { if (about) { const box = $("time").getBoundingClientRect(); go(Math.floor((event.clientX - box.left - 8) / (box.width - 16) * about.frames)); } };
  $("time").addEventListener("pointerdown", event => { $("time").setPointerCapture(event.pointerId); scrub(event); });
  $("time").addEventListener("pointermove", event => { if (event.buttons & 1) scrub(event); });
}
window.addEventListener("resize", timeline);

/* What a test, or a script of one's own, has to know: where a pixel of a picture stands on the screen, and the state. */
window.editor = {
  screenOf(camera, x, y) { const view = views[camera], box = view.above.getBoundingClientRect(), [u, v] = view.screen([x, y]); return [box.left + u, box.top + v]; },
  inView(camera, x, y) { const view = views[camera], [u, v] = view.screen([x, y]); return u > 0 && v > 0 && u < view.width && v < view.height; },
  state: () => ({ frame, shown, overview, chosen, dragging: drag ? drag.handle : null, solving, message: $("message").textContent, silhouettes: !!silhouettes }),
  pictures: () => views.map(view => !!picture(frame, view.number).ready),
  ready: () => !!(shown && !shown.stale && shown.frame === frame && overview && views.every(view => view.placed)),
};
connect();
