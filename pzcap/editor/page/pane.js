"use strict";
/* Of all pages: a picture that is zoomed and moved, and elements from lists. */

const $ = id => document.getElementById(id);
const PALETTE = getComputedStyle(document.documentElement);
const colour = name => PALETTE.getPropertyValue(`--${name}`).trim();

/* Elements from lists: ["td.kind", what is inside, ...]. */
function fill(parent, rows) { parent.replaceChildren(...rows.map(element)); }
function element(row) {
  if (typeof row === "string" || row instanceof Node) return row;
  const [name, ...inside] = row, [tag, kind] = name.split("."), made = document.createElement(tag);
  if (kind) made.className = kind;
  made.append(...inside.map(element));
  return made;
}

/* A picture, and on a canvas above it what is drawn over it. A page says what is in it: `size`, `fit`, `paint`, `draw`,
   `down`, `move`, `up`. */
class Pane {
  constructor(parent) {
    this.scale = 1; this.left = 0; this.top = 0; this.placed = false; this.mouse = [0, 0];
    this.box = document.createElement("div"); this.box.className = "view";
    this.under = document.createElement("canvas"); this.above = document.createElement("canvas");
    this.label = document.createElement("span"); this.label.className = "label";
    this.box.append(this.under, this.above, this.label);
    parent.append(this.box);
    this.above.addEventListener("pointerdown", e => this.down(e));
    this.above.addEventListener("pointermove", e => this.move(e));
    this.above.addEventListener("pointerup", e => this.up(e));
    this.above.addEventListener("contextmenu", e => e.preventDefault());
    this.above.addEventListener("wheel", e => { e.preventDefault(); this.zoom(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)), this.at(e)); }, { passive: false });
    new ResizeObserver(() => this.resize()).observe(this.box);
  }

  resize() {
    const { width, height } = this.box.getBoundingClientRect();
    if (!width || !height) return;
    const sought = this.sought();
    this.width = width; this.height = height; this.ratio = window.devicePixelRatio || 1;
    for (const canvas of [this.under, this.above]) { canvas.width = Math.round(width * this.ratio); canvas.height = Math.round(height * this.ratio); }
    if (!sought) return this.fit(true);
    this.show(sought);
    this.resized = { sought, scale: this.scale, left: this.left, top: this.top };
    this.paint();
  }

  /* The part of the picture that stays in sight as the window is resized: what was in sight before it first was. */
  sought() {
    const last = this.resized;
    if (!this.placed || !this.width) return null;
    if (last && last.scale === this.scale && last.left === this.left && last.top === this.top) return last.sought;
    const [x0, y0] = this.pixel([0, 0]), [x1, y1] = this.pixel([this.width, this.height]), [w, h] = this.size;
    const inside = [Math.max(x0 + 0.5, 0), Math.max(y0 + 0.5, 0), Math.min(x1 + 0.5, w), Math.min(y1 + 0.5, h)];
    return inside[0] < inside[2] && inside[1] < inside[3] ? inside : [x0 + 0.5, y0 + 0.5, x1 + 0.5, y1 + 0.5];
  }

  /* Picture coordinates have (0, 0) in the middle of the first pixel. */
  screen([x, y]) { return [(x + 0.5) * this.scale + this.left, (y + 0.5) * this.scale + this.top]; }
  pixel([u, v]) { return [(u - this.left) / this.scale - 0.5, (v - this.top) / this.scale - 0.5]; }
  at(event) { const box = this.above.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; }

  show([x0, y0, x1, y1]) {
    this.scale = Math.min(this.width / (x1 - x0), this.height / (y1 - y0), 40);
    this.left = (this.width - (x0 + x1) * this.scale) / 2; this.top = (this.height - (y0 + y1) * this.scale) / 2;
  }

  zoom(factor, [u, v]) {
    const scale = Math.min(Math.max(this.scale * factor, 0.05), 60), by = scale / this.scale;
    this.left = u - (u - this.left) * by; this.top = v - (v - this.top) * by; this.scale = scale;
    this.paint();
  }

  /* An image that is `ready`, `missing`, or still to come: then what stands there is darkened. */
  paintPicture(image) {
    const pen = this.under.getContext("2d"), k = this.ratio;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    if (image.ready || image.missing) pen.clearRect(0, 0, this.under.width, this.under.height);
    else { pen.fillStyle = "#0006"; pen.fillRect(0, 0, this.under.width, this.under.height); }
    if (!image.ready) return;
    pen.setTransform(this.scale * k, 0, 0, this.scale * k, this.left * k, this.top * k);
    pen.imageSmoothingEnabled = this.scale * k < 3; pen.imageSmoothingQuality = "medium";
    pen.drawImage(image, 0, 0);
  }

  /* The canvas above the picture, emptied. */
  emptied() {
    const pen = this.above.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.above.width, this.above.height);
    return pen;
  }

  text(pen, words, u, v, style) {
    pen.font = "13px system-ui, 'DejaVu Sans', sans-serif"; pen.lineJoin = "round";
    const wide = pen.measureText(words).width;
    u = Math.min(u, this.width - wide - 4); v = Math.min(Math.max(v, 14), this.height - 4);
    pen.strokeStyle = "#000c"; pen.lineWidth = 4; pen.strokeText(words, u, v); pen.fillStyle = style; pen.fillText(words, u, v);
  }
}
