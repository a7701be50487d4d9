// Buttons, menus and keys.
function runName(run) {
  const tasks = new Set(runs().map((r) => r.task));
  return run.name + (tasks.size > 1 ? `, ${run.task}` : "") + (run.variant ? `, ${run.variant}` : "");
}

function swatch(run) {
  const dash = run.dash.map((d) => 2 * d).join(" ");
  return `<svg width="30" height="8" aria-hidden="true"><path d="M0 4H30" stroke="${tint(run)}" stroke-width="2.5" stroke-dasharray="${dash}"/></svg>`;
}

function option(value, text, selected) {
  const o = document.createElement("option");
  o.value = value; o.textContent = text; o.selected = selected;
  return o;
}

function fillRuns() {
  $$("runs").replaceChildren(...runs().map((run) => {
    const line = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox"; box.checked = S.shown.has(run.key) || run === focus(); box.disabled = run === focus();
    box.addEventListener("change", () => { S.shown[box.checked ? "add" : "delete"](run.key); changed(); });
    line.append(box);
    line.insertAdjacentHTML("beforeend", swatch(run));
    line.append(runName(run) + (run.status === "ok" ? "" : ` (${run.status})`));
    if (run.why) line.title = run.why;
    return line;
  }));
}

function fillLegend() {
  const run = focus(), parts = [];
  const mark = { dot: "●", star: "✳", cross: "✕", ring: "○" };
  if (run.scored) {
    const count = [0, 0, 0, 0];
    for (const o of decided(run).outcome) count[o] += 1;
    OUTCOMES.forEach((o, i) => parts.push(`<span><b style="color:${shade(o.colour)}">${mark[o.mark]} ${o.name}</b> ${o.about} (${count[i]})</span>`));
  } else if (run.decides) parts.push(`<span>● observations; their true landmarks are unknown</span>`);
  for (const state of run.loops || []) parts.push(`<span><b style="color:${shade(state.colour)}">―</b> loop closure ${state.name}</span>`);
  if (recording.head.truth) parts.push(`<span><b style="color:${ink()}">―</b> truth, with a hollow robot; ${recording.head.walls ? "grey lines: true walls" : "+ true landmarks"}</span>`);
  parts.push(...teamLegend());
  $$("legend").innerHTML = parts.join(" ");
}

/** Another run or phase is shown in detail. */
function focused() {
  const run = focus();
  S.shown.add(run.key); S.row = -1;
  for (const radio of document.querySelectorAll("input[name=phase]")) radio.checked = radio.value === S.phase;
  const notes = [];
  if (run.status !== "ok") notes.push(`${run.status}, ${run.why}.`);
  if (!run.phases.includes(S.phase)) notes.push(`It has no ${S.phase} path; the ${phaseOf(run)} one is shown.`);
  if (run.decides && run.task === "slam") {
    if (phaseOf(run) === "final") notes.push("Landmarks are those of the last map.");
    else if (run.history && !run.covariances) notes.push(`Landmarks every ${run.every} frames with observations, without ellipses: a smoother's marginals take longer than the run.`);
    else if (recording.head.walls && recording.head.now !== undefined) notes.push("Walls each second, without changes below 1 mm or 1 mrad.");
    else if (run.history) notes.push(`Landmarks after ${run.every > 1 ? `every ${run.every} frames with observations (large map)` : "each frame"}, without changes below ${1000 * recording.head.quantum} mm.`);
    else notes.push("Landmarks in their final places; earlier places were not recorded.");
  }
  $$("about").textContent = notes.join(" ");
  const wrong = run.decides && wrongFrames().length > 0;
  $$("wrong-back").disabled = $$("wrong-next").disabled = !wrong;
  fillRuns(); fillLegend(); makePlots(); changed();
}

function wire() {
  const head = recording.head, observations = recording.column("point").length;
  $$("facts").textContent = `${recording.frames} frames, ${observations} observations. ${head.left_out.join(" ")}`;
  $$("slider").max = recording.frames - 1;
  // first a run with its own decisions and earlier landmarks; joint compatibility before other methods
  const worth = (r) => 16 * (robots().length > 0 && !r.variant) + 8 * ((r.decides || (r.loops || []).length > 0) && r.status === "ok") + 4 * r.candidates + 2 * r.history + (r.association !== "known") + 0.5 * r.association.startsWith("jcbb");
  S.run = runs().reduce((best, r, i) => (worth(r) > worth(runs()[best]) ? i : best), 0);
  const few = new Map();
  for (const run of runs()) if (!few.has(run.estimator) && run.task === focus().task) few.set(run.estimator, run.key);
  S.shown = new Set(robots().length ? [] : few.values());
  const groups = new Map();
  for (const [i, run] of runs().entries()) {
    const name = run.variant ? `${run.task}, ${run.variant}` : run.task;
    if (!groups.has(name)) { const g = document.createElement("optgroup"); g.label = name; groups.set(name, g); }
    groups.get(name).append(option(i, run.name + (run.variant ? `, ${run.variant}` : ""), i === S.run));
  }
  $$("focus").replaceChildren(...groups.values());
  $$("focus").addEventListener("change", (e) => { if (robots().length) S.shown.delete(focus().key); S.run = +e.target.value; focused(); });
  const unit = head.indexed ? " frames/s" : "×";
  const speeds = [0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 200];
  S.speed = head.indexed ? 2 : 1;
  $$("speed").replaceChildren(...speeds.map((s) => option(s, `${s}${unit}`, s === S.speed)));
  $$("speed").addEventListener("change", (e) => { S.speed = +e.target.value; });
  for (const radio of document.querySelectorAll("input[name=phase]")) {
    radio.addEventListener("change", () => { S.phase = radio.value; focused(); });
  }
  for (const name of ["follow", "numbers", "rays"]) {
    $$(name).addEventListener("change", (e) => { S[name] = e.target.checked; changed(); });
  }
  $$("enlarge").addEventListener("change", (e) => { S.enlarge = +e.target.value; changed(); });
  $$("play").addEventListener("click", () => play(!S.playing));
  $$("back").addEventListener("click", () => { play(false); go(S.frame - 1); });
  $$("forward").addEventListener("click", () => { play(false); go(S.frame + 1); });
  $$("wrong-back").addEventListener("click", () => toWrong(-1));
  $$("wrong-next").addEventListener("click", () => toWrong(1));
  $$("slider").addEventListener("input", (e) => { const on = S.playing; go(+e.target.value); S.playing = on; });
  $$("nearer").addEventListener("click", () => mapView.zoom(1.4));
  $$("further").addEventListener("click", () => mapView.zoom(1 / 1.4));
  $$("whole").addEventListener("click", () => { unfollow(); mapView.fit(worldBox()); changed(); });
  document.addEventListener("keydown", key);
  wireDetail();
  focused();
}

function unfollow() { S.follow = false; $$("follow").checked = false; }

const KEYS = {
  ArrowLeft: (e) => { play(false); go(S.frame - (e.shiftKey ? 10 : 1)); },
  ArrowRight: (e) => { play(false); go(S.frame + (e.shiftKey ? 10 : 1)); },
  Home: () => go(0), End: () => go(recording.frames - 1), " ": () => play(!S.playing),
  n: () => toWrong(1), N: () => toWrong(-1), "+": () => mapView.zoom(1.4), "-": () => mapView.zoom(1 / 1.4),
  0: () => $$("whole").click(), f: () => $$("follow").click(), b: () => $$("numbers").click(),
  o: () => { S.phase = S.phase === "online" ? "final" : "online"; focused(); },
};

function key(e) {
  const where = e.target.tagName, own = where === "SELECT" || (where === "INPUT" && e.target.type !== "checkbox");
  if (e.ctrlKey || e.metaKey || e.altKey || own || (e.key === " " && where !== "CANVAS" && where !== "BODY")) return;
  const act = KEYS[e.key];
  if (act) { e.preventDefault(); act(e); }
}
