// Error with 3 sigma and NEES (without truth: 3 sigma and NIS) over time, with a cursor at the present frame.
let plots = [];
const WHOLE = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000]; // frames are whole
const COMPONENTS = [["x", 0, "m", 1], ["y", 1, "m", 1], ["heading", 2, "°", 180 / Math.PI]];

function wrapped(angle) { return Math.atan2(Math.sin(angle), Math.cos(angle)); }

function errorSeries(run, component) {
  const p = path(run), truth = recording.of("truth"), heading = recording.column("truth_theta");
  const [, axis, , factor] = COMPONENTS[component], n = recording.frames;
  const error = new Array(n).fill(null), high = new Array(n).fill(null), low = new Array(n).fill(null);
  for (let k = 0; k < n; k++) {
    const s = 3 * p.sigma[axis][k] * factor;
    if (Number.isFinite(s)) { high[k] = s; low[k] = -s; }
    if (!recording.head.truth) continue;
    const e = axis === 2 ? wrapped(p.theta[k] - heading[k]) : p.xy[axis][k] - truth[axis][k];
    if (Number.isFinite(e)) error[k] = e * factor;
  }
  return [error, high, low];
}

function consistencySeries(run) {
  const values = recording.head.truth ? path(run).nees : recording.column(run.key + "nis");
  return values && values.some(Number.isFinite) ? Array.from(values, (v) => (Number.isFinite(v) && v > 0 ? Math.max(v, 1e-4) : null)) : null;
}

function plotInto(place, title, unit, series, data, more) {
  const axis = { stroke: ink(), grid: { stroke: DARK.matches ? "#33373d" : "#e4e4e4", width: 1 }, ticks: { stroke: faint(), width: 1 }, font: "11px system-ui, sans-serif" };
  let logarithmic = {};
  const indexed = recording.head.indexed, unitOfTime = indexed ? "frame" : "time [s]";
  const whole = indexed ? { incrs: WHOLE } : {};
  if (more.y) { // decades alone, also those below a thousandth
    const decades = (_, at) => at.map((v) => (v > 0 && Math.abs(Math.log10(v) % 1) < 1e-9 ? v : null));
    logarithmic = { filter: decades, values: (_, at) => at.map((v) => (v === null ? "" : String(+v.toPrecision(3)))), grid: { ...axis.grid, filter: decades }, ticks: { ...axis.ticks, filter: decades } };
  }
  const plot = new uPlot({
    width: Math.max(place.clientWidth, 200), height: 170, title: "", legend: { show: true, live: false },
    cursor: { y: false, drag: { x: true, y: false }, points: { show: false } },
    scales: { x: { time: false }, ...more },
    axes: [{ ...axis, ...whole, label: unitOfTime, labelSize: 18, size: 32 }, { ...axis, ...logarithmic, label: `${title}${unit ? ` [${unit}]` : ""}`, labelSize: 16, size: 58, space: 22 }],
    series: [{ label: unitOfTime }, ...series],
  }, data, place);
  const cursor = document.createElement("div");
  cursor.className = "cursor";
  plot.over.append(cursor);
  plot.over.addEventListener("click", (e) => {
    const t = plot.posToVal(e.offsetX, "x");
    if (Math.abs(e.offsetX - plot.pressed) < 4) { play(false); go(after(recording.column("time"), t) - 1); }
  });
  plot.over.addEventListener("mousedown", (e) => { plot.pressed = e.offsetX; });
  plots.push({ plot, cursor, place });
}

function makePlots() {
  for (const { plot } of plots) plot.destroy();
  plots = [];
  const run = focus(), head = recording.head, time = Array.from(recording.column("time"));
  if (!$$("component").options.length) {
    $$("component").replaceChildren(...COMPONENTS.map(([name], i) => option(i, name, i === S.component)));
    $$("component").addEventListener("change", (e) => { S.component = +e.target.value; makePlots(); });
    new ResizeObserver(() => { for (const { plot, place } of plots) plot.setSize({ width: Math.max(place.clientWidth, 200), height: 170 }); moveCursors(); }).observe($$("plots"));
  }
  $$("plot-error").hidden = $$("plot-nees").hidden = !path(run).xy;
  if (!path(run).xy) return;
  const [name, , unit] = COMPONENTS[S.component], colour = tint(run);
  const [error, high, low] = errorSeries(run, S.component);
  const band = { stroke: faint(), width: 1, dash: [4, 3], points: { show: false } };
  const shown = [{ label: "+3σ", ...band }, { label: "−3σ", ...band }], data = [time, high, low];
  if (head.truth) { shown.unshift({ label: `${run.name}, ${phaseOf(run)}`, stroke: colour, width: 1.4 }); data.splice(1, 0, error); }
  plotInto($$("plot-error"), head.truth ? `error of ${name}` : `±3σ of ${name}`, unit, shown, data, {});
  const values = consistencySeries(run);
  $$("plot-nees").hidden = !values;
  $$("plot-note").textContent = head.truth ? "A consistent pose has a NEES within the band in 95 % of the frames." : `The log has no true path, so there are no errors.${values ? ` NIS per degree of freedom: ${run.nis_expected.toFixed(2)} expected.` : ""}`;
  $$("plot-error").setAttribute("aria-label", `Error of ${name} of ${runName(run)} over time with its own 3 sigma`);
  $$("plot-nees").setAttribute("aria-label", `${head.truth ? "NEES" : "NIS"} of ${runName(run)} over time`);
  if (values) {
    const lines = (head.truth ? head.band : [run.nis_expected]).map((v) => ({ label: head.truth ? `95 %: ${v.toFixed(2)}` : `expected: ${v.toFixed(2)}`, ...band }));
    const levels = (head.truth ? head.band : [run.nis_expected]).map((v) => new Array(time.length).fill(v));
    const points = head.truth ? {} : { paths: () => null, points: { show: true, size: 3, stroke: colour, fill: colour } };
    plotInto($$("plot-nees"), head.truth ? "pose NEES" : "NIS per dof", "", [{ label: head.truth ? "NEES" : "NIS", stroke: colour, width: 1.2, ...points }, ...lines], [time, values, ...levels], { y: { distr: 3 } });
  }
  moveCursors();
}

function moveCursors() {
  const t = timeOf(S.frame);
  for (const { plot, cursor } of plots) {
    const x = plot.valToPos(t, "x");
    cursor.style.transform = `translateX(${Math.round(x)}px)`;
    cursor.style.display = x >= 0 && x <= plot.over.clientWidth ? "" : "none";
  }
}
