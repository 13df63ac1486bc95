// Makes the charts of a page live: values under the pointer, zoom, series on and off. Without it the pictures stay.
(() => {
"use strict";
const root = document.documentElement, NS = "http://www.w3.org/2000/svg";
const css = name => getComputedStyle(root).getPropertyValue("--" + name).trim();
const dark = matchMedia("(prefers-color-scheme: dark)");
const NIGHT = {"#262b30": "#e4e8ec", "#606870": "#a0a8b0", "#0072B2": "#56aef0", "#D55E00": "#ff8a3d", "#009E73": "#2fcf9f",
  "#CC79A7": "#e79bc6", "#E69F00": "#ffbf3a", "#56B4E9": "#8fd3ff", "#7A4B2A": "#c9946b", "#8A8A00": "#c8c83c", "#dfe3e7": "#3c444c"};
const colour = c => dark.matches ? NIGHT[c] || c : c;

function make(tag, attributes, ...children) {
  const e = document.createElement(tag);
  for (const [k, v] of Object.entries(attributes || {})) k === "class" ? e.className = v : e.setAttribute(k, v);
  e.append(...children);
  return e;
}
function svg(tag, attributes, parent) {
  const e = document.createElementNS(NS, tag);
  for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v);
  if (parent) parent.append(e);
  return e;
}

// numbers as they were packed: a list, an even grid, or 16 bits on a scale
function numbers(a) {
  if (a == null || Array.isArray(a)) return a;
  if (a.exp) return numbers(a.exp).map(v => v == null ? null : Math.exp(v));
  if (a.n) return Array.from({length: a.n}, (_, i) => a.from + (a.to - a.from) * i / (a.n - 1));
  const text = atob(a.data), out = new Array(text.length / 2);
  for (let i = 0; i < out.length; i++) {
    const whole = text.charCodeAt(2 * i) | text.charCodeAt(2 * i + 1) << 8;
    out[i] = whole === 65535 ? null : a.low + a.step * whole;
  }
  return out;
}
const RAISED = {"-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹"};
function figure(v, digits = 4) {
  if (v == null || !isFinite(v)) return "–";
  if (v === 0) return "0";
  const size = Math.abs(v);
  let text;
  if (size >= 1e-4 && size < 1e6) text = v.toFixed(Math.max(0, digits - 1 - Math.floor(Math.log10(size))));
  else {
    const [m, e] = v.toExponential(digits - 1).split("e");
    text = m + "·10" + [...String(+e)].map(c => RAISED[c]).join("");
  }
  return text.replace("-", "−");
}
// as a tick says it: no more digits than it needs
function short(v) {
  if (v == null) return "";
  if (v === 0) return "0";
  const size = Math.abs(v);
  if (size >= 1e-4 && size < 1e5) return String(+v.toPrecision(6)).replace("-", "−");
  return figure(v, 2).replace(/\.0·/, "·").replace(/^1·/, "");
}
const quantity = (v, axis) => figure(v) + (axis.unit ? " " + axis.unit : "");

// ---------------------------------------------------------------------------------------------------- one figure

class Figure {
  constructor(element, chart) {
    this.element = element;
    this.chart = chart;
    this.off = new Map();
    this.box = make("div", {class: "live"});
    this.legend = make("div", {class: "legend"});
    this.tools = make("div", {class: "tools"});
    this.area = make("div", {class: "panels"});
    this.tip = make("div", {class: "tip", role: "status"});
    this.box.append(this.legend, this.tools, this.area, this.tip);
    element.querySelector(".still").before(this.box);
    element.classList.add("alive");
    this.choice = 0;
    this.fill();
    this.build();
    let last = this.area.clientWidth;
    new ResizeObserver(() => {
      if (this.area.clientWidth && Math.abs(this.area.clientWidth - last) > 2) { last = this.area.clientWidth; this.build(); }
    }).observe(this.area);
    dark.addEventListener("change", () => { this.fill(); this.build(); });
    addEventListener("beforeprint", () => this.caption(0));  // what is printed is the picture
    addEventListener("afterprint", () => this.caption(this.choice));
  }

  caption(choice) { this.element.querySelector("figcaption").textContent = this.chart.choices[choice].caption; }

  get panels() { return this.chart.choices[this.choice].panels; }

  fill() {
    this.legend.replaceChildren();
    this.tools.replaceChildren();
    const known = new Map();
    for (const p of this.panels) for (const i of p.items)
      if (i.name && !known.has(i.name)) known.set(i.name, i);
    for (const [name, item] of known) {
      if (!this.off.has(name)) this.off.set(name, item.on === false);
      const key = svg("svg", {width: 30, height: 12, "aria-hidden": "true"});
      const c = colour(item.look.colour);
      if (item.fill) svg("rect", {x: 1, y: 0, width: 28, height: 12, fill: css("pale")}, key);
      else if (item.kind === "line" || !item.look.marker || item.look.marker === "|")
        svg("line", {x1: 1, x2: 29, y1: 6, y2: 6, stroke: c, "stroke-width": item.kind === "marks" ? Math.max(2, item.bar) : 2,
          "stroke-dasharray": (item.look.dash || []).map(d => 1.6 * d).join(" ")}, key);
      else mark(key, item.look.marker, 15, 6, 4.5, c, item.open);
      const button = make("button", {type: "button", "aria-pressed": String(!this.off.get(name)), title: "show or hide"}, key, name);
      button.onclick = () => {
        this.off.set(name, !this.off.get(name));
        button.setAttribute("aria-pressed", String(!this.off.get(name)));
        this.build(true);
      };
      this.legend.append(button);
    }
    if (known.size < 2) this.legend.replaceChildren();
    if (this.chart.choices.length > 1) {
      const list = make("select", {"aria-label": "record"});
      this.chart.choices.forEach((c, i) => list.append(make("option", {value: i}, c.name)));
      list.value = this.choice;
      list.onchange = () => { this.choice = +list.value; this.windows = null; this.caption(this.choice); this.fill(); this.build(); };
      this.tools.append(list);
    }
    const tool = (text, says, action) => {
      const b = make("button", {type: "button", title: says, "aria-label": says}, text);
      b.onclick = action;
      this.tools.append(b);
    };
    if (this.chart.walk) {
      tool("◀", "earlier", () => this.move(-0.5, 1));
      tool("▶", "later", () => this.move(0.5, 1));
      tool("+", "closer", () => this.move(0, 0.5));
      tool("−", "wider", () => this.move(0, 2));
    }
    tool("reset zoom", "show the whole range (double click)", () => this.whole());
    this.tools.append(make("span", {class: "hint"}, "drag to zoom"));
  }

  build(keep) {
    const windows = keep ? this.windows : this.windows = this.windows || {};
    for (const p of this.plots || []) p.destroy();
    this.hide();
    this.plots = [];
    this.area.replaceChildren();
    const room = this.area.clientWidth || 640;
    const columns = Math.max(1, Math.min(this.chart.columns, Math.floor(room / 230), this.panels.length));
    this.area.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
    const width = Math.floor((room - 12 * (columns - 1)) / columns);
    // in one column what belongs together stands together
    const order = columns === this.chart.columns ? this.panels : [...this.panels].sort((a, b) =>
      this.panels.findIndex(p => p.link && p.link === a.link) - this.panels.findIndex(p => p.link && p.link === b.link));
    for (const panel of (this.panels.every(p => p.link) && !this.chart.walk ? order : this.panels)) {
      const cell = make("div", {class: "panel"});
      const label = panel.kind === "lines" || this.chart.walk || panel.y.label.includes("\n") ? panel.y.label.replace("\n", " ") + (panel.y.unit ? ` [${panel.y.unit}]` : "") : "";
      const head = make("h4", {}, panel.title);
      if (label) head.append(make("small", {}, (panel.title ? "  " : "") + label));
      cell.append(head);
      this.area.append(cell);
      const plot = panel.kind === "lines" ? lines(this, panel, cell, width, columns) : points(this, panel, cell, width, columns);
      plot.panel = panel;
      this.plots.push(plot);
      const w = windows[panel.link || this.panels.indexOf(panel)];
      if (w) plot.window(w);
    }
  }

  // panels of one link go together
  zoomed(panel, low, high) {
    if (this.busy) return;
    this.busy = true;
    this.windows[panel.link || this.panels.indexOf(panel)] = [low, high];
    for (const p of this.plots) if (p.panel && p.panel !== panel && p.panel.link && p.panel.link === panel.link) p.window([low, high]);
    this.busy = false;
  }
  whole() {
    this.windows = {};
    this.busy = true;
    for (const p of this.plots) p.window(p.reach);
    this.busy = false;
    for (const p of this.plots) this.windows[p.panel.link || this.panels.indexOf(p.panel)] = p.reach;
  }
  move(by, times) {
    const seen = new Set();
    for (const p of [...this.plots]) {
      const key = p.panel.link || p;
      if (seen.has(key) || (this.chart.walk && p.panel.link !== this.panels[0].link)) continue;
      seen.add(key);
      const [a, b] = p.now(), [low, high] = p.reach;
      const half = Math.min(0.5 * (b - a) * times, 0.5 * (high - low));
      let middle = 0.5 * (a + b) + by * (b - a);
      middle = Math.min(Math.max(middle, low + half), high - half);
      p.window([middle - half, middle + half]);
      this.zoomed(p.panel, middle - half, middle + half);
    }
  }

  say(lines, event) {
    if (!lines.length) return this.hide();
    this.tip.replaceChildren(...lines.map(([text, c]) => {
      const row = make("div", {}, text);
      if (c) row.prepend(Object.assign(make("i"), {style: `background:${c}`}));
      return row;
    }));
    this.tip.style.display = "block";
    const box = this.box.getBoundingClientRect(), w = this.tip.offsetWidth, h = this.tip.offsetHeight;
    const x = event.clientX - box.left, y = event.clientY - box.top;
    this.tip.style.left = Math.max(0, Math.min(box.width - w, x + 16 + w > box.width ? x - w - 16 : x + 16)) + "px";
    this.tip.style.top = Math.max(0, y - h - 10 < -40 ? y + 18 : y - h - 10) + "px";
  }
  hide() { this.tip.style.display = "none"; }
}

// ------------------------------------------------------------------------------------------- curves over a shared x

function ticksOf(axis, low, high) {
  return axis.ticks ? axis.ticks.filter(([t]) => t >= low * (1 - 1e-9) && t <= high * (1 + 1e-9)) : null;
}

function lines(fig, panel, cell, width, columns) {
  const curves = panel.items.filter(i => i.kind === "line");
  const grid = curves[0];
  curves.sort((a, b) => (b.fill ? 1 : 0) - (a.fill ? 1 : 0));  // what is shaded lies below
  const x = grid.xs_ || (grid.xs_ = numbers(grid.x));
  const data = [x], series = [{}], bands = [];
  for (const c of curves) {
    const stroke = colour(c.look.colour), show = !fig.off.get(c.name);
    data.push(c.ys_ || (c.ys_ = numbers(c.y)));
    series.push({label: c.name, show, stroke: c.fill ? css("pale") : stroke, width: c.look.width, dash: c.look.dash.length ? c.look.dash.map(d => 1.4 * d) : undefined,
      fill: c.fill ? css("pale") : undefined, fillTo: c.fill ? (u => u.scales.y.min) : undefined, points: {show: false}, spanGaps: false});
    if (c.band) {
      const k = data.length;
      data.push(numbers(c.band[1]), numbers(c.band[0]));
      for (let i = 0; i < 2; i++) series.push({show, stroke: "transparent", points: {show: false}, helper: true});
      bands.push({series: [k, k + 1], fill: stroke + "38"});
    }
  }
  const finite = x.filter(v => v != null), reach = [Math.min(...ends(finite)), Math.max(...ends(finite))];
  const first = [panel.x.low == null ? reach[0] : panel.x.low, panel.x.high == null ? reach[1] : panel.x.high];
  const own = fig.panels.filter(p => p.link === panel.link), last = !fig.chart.walk || own[own.length - 1] === panel;
  let zoom = first, pinned = true;   // the y range that was chosen holds until somebody zooms
  const axis = (a, side) => ({
    stroke: css("ink"), grid: {stroke: css("line"), width: 1}, ticks: {stroke: css("line"), width: 1, size: 4},
    font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
    label: side === "y" || !last ? undefined : a.label + (a.unit ? ` [${a.unit}]` : ""),
    labelSize: 18, size: side === "y" ? 52 : 26, space: side === "y" ? 24 : (u, i, low, high, wide) => Math.max(28, Math.min(48, wide / 4)),
    ...(a.ticks && a.log ? {splits: (u, i, low, high) => ticksOf(a, low, high).map(t => t[0]),
      values: (u, splits) => splits.map(s => (a.ticks.find(t => t[0] === s) || ["", ""])[1]), filter: (u, s) => s}
      : {values: (u, splits) => splits.map(s => s == null ? "" : short(+s.toPrecision(12)))}),
  });
  const draw = [u => {
    const c = u.ctx;
    c.save();
    for (const i of panel.items) if (i.kind === "span") {
      const a = u.valToPos(Math.max(i.low, u.scales.x.min), "x", true), b = u.valToPos(Math.min(i.high, u.scales.x.max), "x", true);
      if (b > a) { c.fillStyle = css("pale"); c.globalAlpha = .6; c.fillRect(a, u.bbox.top, b - a, u.bbox.height); c.globalAlpha = 1; }
    }
    c.restore();
  }];
  const after = [u => {
    const c = u.ctx;
    c.save();
    c.beginPath();
    c.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    c.clip();
    for (const i of panel.items) if (i.kind === "rule") {
      const p = Math.round(u.valToPos(i.at, i.axis, true)) + .5;
      c.strokeStyle = colour(i.look.colour);
      c.lineWidth = devicePixelRatio;
      c.setLineDash((i.look.dash || []).map(d => 2 * d * devicePixelRatio));
      c.beginPath();
      if (i.axis === "x") { c.moveTo(p, u.bbox.top); c.lineTo(p, u.bbox.top + u.bbox.height); }
      else { c.moveTo(u.bbox.left, p); c.lineTo(u.bbox.left + u.bbox.width, p); }
      c.stroke();
      if (i.text) {
        c.fillStyle = css("ink"); c.font = `${11 * devicePixelRatio}px system-ui, sans-serif`; c.textBaseline = "top";
        c.fillText(i.text, p + 4 * devicePixelRatio, u.bbox.top + 2);
      }
    }
    c.restore();
  }];
  const known = panel.y.low != null && panel.y.high != null;
  const plot = new uPlot({
    width, height: Math.round((fig.chart.walk ? 130 : columns > 2 ? 170 : 190) * (panel.tall || 1)) + (last ? 36 : 18), padding: [8, 10, 0, 0],
    legend: {show: false},
    cursor: {drag: {x: true, y: false}, points: {size: 6}, sync: panel.link ? {key: fig.element.id + panel.link, scales: ["x", null]} : undefined},
    scales: {
      x: {time: false, distr: panel.x.log ? 3 : 1, range: (u, low, high) => panel.x.log ? [low, high] : [low, high]},
      y: {distr: panel.y.log ? 3 : 1, range: (u, low, high) => {
        if (known && (pinned || panel.y.log)) return [panel.y.low, panel.y.high];
        if (low == null) return [panel.y.log ? 1 : 0, panel.y.log ? 10 : 1];
        if (panel.y.log) return [low / 1.3, high * 1.3];
        const room = .06 * (high - low) || 1;
        return [low - room, high + room];
      }},
    },
    axes: [axis(panel.x, "x"), axis(panel.y, "y")],
    series, bands,
    hooks: {
      drawClear: draw, draw: after,
      setScale: [(u, key) => {
        if (key !== "x" || !u.ready_) return;
        const a = u.scales.x.min, b = u.scales.x.max;
        if (Math.abs(a - zoom[0]) + Math.abs(b - zoom[1]) > 1e-9 * (b - a)) { zoom = [a, b]; pinned = false; fig.zoomed(panel, a, b); }
      }],
    },
  }, data, cell);
  plot.setScale("x", {min: first[0], max: first[1]});
  plot.ready_ = true;
  plot.over.addEventListener("mousemove", event => {
    const k = plot.cursor.idx;
    if (k == null) return fig.hide();
    const rows = [[`${panel.x.label || "x"} ${quantity(x[k], panel.x)}`]];
    plot.series.forEach((s, i) => {
      if (i && s.show && !s.helper && s.label && plot.data[i][k] != null) rows.push([`${s.label}: ${quantity(plot.data[i][k], panel.y)}`, s.stroke instanceof Function ? s.stroke(plot, i) : s.stroke]);
    });
    fig.say(rows, event);
  });
  plot.over.addEventListener("mouseleave", () => fig.hide());
  plot.over.addEventListener("dblclick", event => { event.stopImmediatePropagation(); fig.whole(); }, true);
  return {
    reach,
    now: () => [plot.scales.x.min, plot.scales.x.max],
    window: w => { zoom = w; pinned = w === first; plot.setScale("x", {min: w[0], max: w[1]}); },
    destroy: () => plot.destroy(),
  };
}
const ends = a => a.length < 3 ? a : [a.reduce((m, v) => Math.min(m, v), Infinity), a.reduce((m, v) => Math.max(m, v), -Infinity)];

// ------------------------------------------------------------------------------- points with intervals, clouds, rows

const SHAPES = {s: 4, D: 4.01, "^": 3, v: 3.01, "<": 3.02, ">": 3.03, p: 5, h: 6, d: 4.02, P: 4.03, X: 4.04, "*": 10};
function mark(parent, marker, x, y, r, c, open) {
  const look = {fill: open ? css("paper") : c, stroke: c, "stroke-width": 1.6};
  if (marker === "|") return svg("path", {d: `M${x} ${y - r * 1.4}V${y + r * 1.4}`, stroke: c, "stroke-width": 2.4}, parent);
  if (marker === "P" || marker === "X") {
    const e = svg("path", {d: `M${-r} 0H${r}M0 ${-r}V${r}`, stroke: c, "stroke-width": 3.4, transform: `translate(${x} ${y}) rotate(${marker === "X" ? 45 : 0})`}, parent);
    return e;
  }
  const n = Math.floor(SHAPES[marker] || 0);
  if (!n) return svg("circle", {cx: x, cy: y, r, ...look}, parent);
  const turn = {s: 45, D: 0, d: 0, "^": 0, v: 180, "<": -90, ">": 90}[marker] || 0;
  const corners = Array.from({length: n}, (_, i) => {
    const a = Math.PI * (2 * i / n + turn / 180), reach = r * 1.25 * (marker === "*" && i % 2 ? .45 : 1) * (marker === "d" && i % 2 ? .6 : 1);
    return `${(x + reach * Math.sin(a)).toFixed(2)},${(y - reach * Math.cos(a)).toFixed(2)}`;
  });
  return svg("polygon", {points: corners.join(" "), ...look}, parent);
}

function nice(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 2.5, 5, 10].find(m => m * power >= raw * .999);
  const out = [];
  for (let t = Math.ceil(low / step - 1e-9) * step; t <= high + 1e-9 * step; t += step) out.push(Math.abs(t) < 1e-9 * step ? 0 : +t.toPrecision(10));
  return out;
}

function points(fig, panel, cell, width, columns) {
  const rows = panel.y.rows;
  const longest = rows ? Math.max(...rows.map(r => r.length)) : 0;
  const short_names = rows && 6.6 * longest > .42 * width;
  const left = rows ? (short_names ? 8 : 14 + 7.2 * longest) : 54, right = 12, top = 8, bottom = 42;
  const line = short_names ? 40 : 30;
  const height = rows ? top + bottom + line * rows.length : Math.round(Math.min(Math.max(.62 * width, 260), 430));
  const items = panel.items.map(i => i.kind === "rule" || i.kind === "span" ? i : Object.assign(i, {
    x_: i.x_ || numbers(i.x), y_: i.y_ || numbers(i.y)}));
  const ranges = which => {
    const a = panel[which], all = [];
    for (const i of items) {
      const own = which === "x" ? i.x_ : i.y_;
      if (own) all.push(...ends(own.filter(v => v != null)));
      const span = which === "x" ? i.xs : i.ys;
      if (span) all.push(...span.flat().filter(v => v != null));
      if (i.kind === "rule" && i.axis === which) all.push(i.at);
    }
    const usable = a.log ? all.filter(v => v > 0) : all;
    let low = Math.min(...usable), high = Math.max(...usable);
    if (a.log) { low /= 1.15; high *= 1.15; } else { const room = .05 * (high - low) || 1; low -= room; high += room; }
    return [a.low == null ? low : a.low, a.high == null ? high : a.high];
  };
  const reach = ranges("x"), reachY = rows ? [rows.length - .4, -.6] : ranges("y");
  let view = reach, viewY = reachY;
  const canvas = svg("svg", {width, height, viewBox: `0 0 ${width} ${height}`, class: "points"}, cell);
  const scale = (v, [a, b], from, to, log) => {
    const f = log ? Math.log : Number;
    return from + (to - from) * (f(v) - f(a)) / (f(b) - f(a));
  };
  const X = v => scale(v, view, left, width - right, panel.x.log);
  const Y = v => scale(v, viewY, height - bottom, top, panel.y.log && !rows);
  let spots = [];

  function paint() {
    canvas.replaceChildren();
    spots = [];
    const id = "c" + Math.random().toString(36).slice(2);
    const clip = svg("clipPath", {id}, svg("defs", {}, canvas));
    svg("rect", {x: left, y: top, width: Math.max(1, width - right - left), height: height - bottom - top}, clip);
    const frame = svg("g", {"font-size": 12, fill: css("ink"), "font-family": "system-ui, sans-serif"}, canvas);
    const word = (text, x, y, anchor, more) => { svg("text", {x, y, "text-anchor": anchor, ...more}, frame).textContent = text; };
    const count = Math.max(2, Math.floor((width - left - right) / 70));
    let tx = ticksOf(panel.x, ...view);
    if (!tx || tx.length < 2) tx = (panel.x.log ? logTicks(...view) : nice(...view, count)).map(t => [t, short(t)]);
    const rank = t => panel.x.log ? ["1", "5", "2"].indexOf(t.toExponential()[0]) + 1 || 4 : 0;  // the roundest numbers get their words first
    const taken = [];
    for (const [t, text] of [...tx].sort(([a], [b]) => rank(a) - rank(b))) {
      svg("line", {x1: X(t), x2: X(t), y1: top, y2: height - bottom, stroke: css("line")}, frame);
      const half = 3.4 * text.length + 3;
      if (taken.some(([a, b]) => X(t) - half < b && X(t) + half > a)) continue;
      word(text, X(t), height - bottom + 16, "middle");
      taken.push([X(t) - half, X(t) + half]);
    }
    word(panel.x.label + (panel.x.unit ? ` [${panel.x.unit}]` : ""), width < 420 ? width - right : (left + width - right) / 2, height - 8, width < 420 ? "end" : "middle");
    if (rows) rows.forEach((r, k) => word(r, short_names ? left : left - 8, short_names ? Y(k) - 10 : Y(k) + 4, short_names ? "start" : "end"));
    else {
      for (const t of panel.y.log ? logTicks(...viewY) : nice(...viewY, 6)) {
        svg("line", {x1: left, x2: width - right, y1: Y(t), y2: Y(t), stroke: css("line")}, frame);
        word(short(t), left - 6, Y(t) + 4, "end");
      }
      const label = panel.y.label + (panel.y.unit ? ` [${panel.y.unit}]` : "");
      if (!label.includes("\n")) word(label, 0, 0, "middle", {transform: `translate(12 ${(top + height - bottom) / 2}) rotate(-90)`});
    }
    const inner = svg("g", {"clip-path": `url(#${id})`}, canvas);
    for (const i of items) {
      if (i.kind === "rule") {
        const p = i.axis === "x" ? {x1: X(i.at), x2: X(i.at), y1: top, y2: height - bottom} : {y1: Y(i.at), y2: Y(i.at), x1: left, x2: width - right};
        svg("line", {...p, stroke: colour(i.look.colour), "stroke-width": .9, "stroke-dasharray": (i.look.dash || []).join(" ")}, inner);
        continue;
      }
      if (i.name && fig.off.get(i.name)) continue;
      const c = colour(i.look.colour);
      if (i.kind === "line") {
        if (i.band) {
          const [low, high] = i.band.map(numbers);
          const there = i.x_.map((x, k) => `${X(x).toFixed(1)},${Y(low[k]).toFixed(1)}`);
          const back = i.x_.map((x, k) => `${X(x).toFixed(1)},${Y(high[k]).toFixed(1)}`).reverse();
          svg("polygon", {points: [...there, ...back].join(" "), fill: c, opacity: .25}, inner);
        }
        svg("polyline", {points: i.x_.map((x, k) => `${X(x).toFixed(1)},${Y(i.y_[k]).toFixed(1)}`).join(" "), fill: "none", stroke: c,
          "stroke-width": i.look.width + .2, "stroke-dasharray": (i.look.dash || []).map(d => 1.4 * d).join(" ")}, inner);
        i.x_.forEach((x, k) => spots.push([X(x), Y(i.y_[k]), () => [[i.name, c], [`${panel.x.label} ${quantity(x, panel.x)}`], [`${panel.y.label} ${quantity(i.y_[k], panel.y)}`]], 9]));
      } else if (i.kind === "dots") {
        let path = "";
        for (let k = 0; k < i.x_.length; k++) if (i.x_[k] != null && i.y_[k] != null) path += `M${X(i.x_[k]).toFixed(1)} ${Y(i.y_[k]).toFixed(1)}h0`;
        svg("path", {d: path, stroke: c, "stroke-width": 2.6, "stroke-linecap": "round", opacity: .5}, inner);
        i.x_.forEach((x, k) => { if (x != null) spots.push([X(x), Y(i.y_[k]), () => [[i.name || panel.title, c], [`${panel.x.label} ${quantity(x, panel.x)}`], [`${panel.y.label.replace("\n", " ")} ${quantity(i.y_[k], panel.y)}`]], 8]); });
      } else {
        i.x_.forEach((x, k) => {
          const y = i.y_[k];
          if (x == null || y == null) return;
          for (const [s, flat] of [[i.xs, true], [i.ys, false]]) if (s) {
            const [a, b] = [s[0][k], s[1][k]];
            const p = flat ? {x1: X(a), x2: X(b), y1: Y(y), y2: Y(y)} : {x1: X(x), x2: X(x), y1: Y(a), y2: Y(b)};
            svg("line", {...p, stroke: c, "stroke-width": i.bar + .4}, inner);
          }
          if (i.look.marker) mark(inner, i.look.marker, X(x), Y(y), i.size * .72, c, i.open);
          const note = (i.notes || [])[k];
          if (note) spots.push([X(x), Y(y), () => [[note, c]], 14]);
        });
      }
    }
    if (!rows) names(inner, width);
  }

  // words beside points where there is room, the nearest free place of eight
  function names(parent) {
    const taken = items.filter(i => i.kind === "marks").flatMap(i => i.x_.flatMap((x, k) => {
      const px = X(x), py = Y(i.y_[k]), boxes = [[px - 6, py - 6, px + 6, py + 6]];
      if (i.xs) boxes.push([X(i.xs[0][k]), py - 2, X(i.xs[1][k]), py + 2]);
      if (i.ys) boxes.push([px - 2, Y(i.ys[1][k]), px + 2, Y(i.ys[0][k])]);
      return boxes;
    }));
    for (const i of items) if (i.kind === "marks") (i.texts || []).forEach((text, k) => {
      if (i.name && fig.off.get(i.name)) return;
      const x = X(i.x_[k]), y = Y(i.y_[k]);
      if (x < left || x > width - right || y < top || y > height - bottom) return;
      const words = width < 500 ? text.split(",")[0] : text, w = 6.1 * words.length, h = 13;
      for (const r of [10, 18, 28, 42, 60, 80]) for (const a of [0, 180, 30, -30, 150, -150, 60, -60, 120, -120, 90, -90]) {
        const px = x + r * Math.cos(a * Math.PI / 180), py = y - r * Math.sin(a * Math.PI / 180);
        const l = Math.abs(a) === 90 ? px - w / 2 : Math.abs(a) < 90 ? px : px - w;
        const box = [l, py - h / 2, l + w, py + h / 2];
        if (box[0] < left || box[2] > width - right || box[1] < top || box[3] > height - bottom) continue;
        if (taken.some(b => box[0] < b[2] && b[0] < box[2] && box[1] < b[3] && b[1] < box[3])) continue;
        taken.push(box);
        if (r > 12) svg("line", {x1: x, y1: y, x2: Math.abs(a) < 90 ? box[0] : box[2], y2: py, stroke: colour(i.look.colour), "stroke-width": .6}, parent);
        svg("text", {x: l, y: py + 4, "font-size": 11.5, fill: colour(i.look.colour), class: "rim"}, parent).textContent = words;
        return;
      }
    });
  }

  paint();
  const local = event => { const b = canvas.getBoundingClientRect(); return [event.clientX - b.left, event.clientY - b.top]; };
  let begun = null, rubber = null;
  canvas.addEventListener("pointerdown", event => {
    if (event.pointerType === "mouse") { begun = local(event); canvas.setPointerCapture(event.pointerId); }
  });
  canvas.addEventListener("pointermove", event => {
    const [x, y] = local(event);
    if (begun) {
      rubber = rubber || svg("rect", {class: "rubber"}, canvas);
      for (const [k, v] of Object.entries({x: Math.min(x, begun[0]), y: rows ? top : Math.min(y, begun[1]), width: Math.abs(x - begun[0]),
        height: rows ? height - top - bottom : Math.abs(y - begun[1])})) rubber.setAttribute(k, v);
      return fig.hide();
    }
    say(event, x, y);
  });
  function say(event, x, y) {
    let best = null, least = 14;
    for (const s of spots) {
      const d = Math.hypot(s[0] - x, s[1] - y);
      if (d < least && d < s[3] && s[0] >= left - 1) { least = d; best = s; }
    }
    best ? fig.say(best[2](), event) : fig.hide();
  }
  canvas.addEventListener("pointerup", event => {
    const end = local(event), start = begun;
    begun = null;
    if (rubber) { rubber.remove(); rubber = null; }
    if (!start) return say(event, ...end);
    const undo = (p, [a, b], from, to, log) => { const f = log ? Math.log : Number, g = log ? Math.exp : Number; return g(f(a) + (f(b) - f(a)) * (p - from) / (to - from)); };
    if (Math.abs(end[0] - start[0]) > 8) {
      const xs = [start[0], end[0]].sort((a, b) => a - b).map(p => undo(p, view, left, width - right, panel.x.log));
      if (!rows && Math.abs(end[1] - start[1]) > 8) viewY = [start[1], end[1]].sort((a, b) => b - a).map(p => undo(p, viewY, height - bottom, top, panel.y.log));
      view = xs;
      paint();
      fig.zoomed(panel, ...xs);
    }
  });
  canvas.addEventListener("pointerleave", () => fig.hide());
  canvas.addEventListener("dblclick", () => fig.whole());
  return {
    reach, now: () => view,
    window: w => { view = w; if (w === reach) viewY = reachY; paint(); },
    destroy: () => canvas.remove(),
  };
}
function logTicks(low, high) {
  for (const steps of [[1], [1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9], Array.from({length: 90}, (_, k) => 1 + k / 10)]) {
    const out = [];
    for (let k = Math.floor(Math.log10(low)); k <= Math.ceil(Math.log10(high)); k++)
      for (const m of steps) { const t = +(m * 10 ** k).toPrecision(6); if (t >= low && t <= high) out.push(t); }
    if (out.length > 2) return out.length > 9 ? out.filter((_, i) => i % Math.ceil(out.length / 8) === 0) : out;
  }
  return [];
}

// ------------------------------------------------------------------------------------------------------- the page

for (const element of document.querySelectorAll("figure[data-chart]"))
  try { new Figure(element, JSON.parse(document.getElementById(element.dataset.chart).textContent)); }
  catch (error) { element.classList.remove("alive"); for (const l of element.querySelectorAll(".live")) l.remove(); console.error(error); }

// tables that are wider than the page say so
const wide = () => { for (const t of document.querySelectorAll(".wide")) t.classList.toggle("scrolls", t.scrollWidth > t.clientWidth + 1); };
addEventListener("resize", wide);
wide();

// a rival lights up in the drawing where it would stand
for (const row of document.querySelectorAll("[data-lights]")) {
  const parts = JSON.parse(row.dataset.lights).flatMap(n => [...document.querySelectorAll(`[data-part="${CSS.escape(n)}"]`)]);
  const light = on => () => { for (const p of parts) p.classList.toggle("lit", on); row.classList.toggle("lit", on); };
  row.tabIndex = 0;
  for (const e of ["mouseenter", "focus"]) row.addEventListener(e, light(true));
  for (const e of ["mouseleave", "blur"]) row.addEventListener(e, light(false));
}
})();
