// A frame's observations as a list; of the selected one candidates, gates, decisions of each method, and truth.
let listed = "";

function pick(x, y) {
  let best = null, near = 18;
  for (const m of marks) {
    const d = Math.hypot(m.x - x, m.y - y);
    if (d < near) { near = d; best = m; }
  }
  S.row = best ? best.row : -1;
  if (best) play(false);
  changed();
}

function wireDetail() {
  $$("inspected").addEventListener("change", (e) => { if (e.target.id === "method") { S.method = e.target.value; changed(); } });
}

function inspect() {
  const run = focus(), [from, to] = run.decides ? rowsIn(S.frame) : [0, 0];
  // five lists a second are enough; when play stops, the last frame is listed
  if (S.playing && performance.now() - inspect.last < 200) return;
  inspect.last = performance.now();
  const wanted = [S.frame, S.run, S.phase, S.row, S.method, DARK.matches].join();
  if (wanted === listed) return;
  listed = wanted;
  const d = decided(run), held = document.activeElement && document.activeElement.dataset.row;
  $$("list").replaceChildren(...Array.from({ length: to - from }, (_, i) => {
    const row = from + i, outcome = outcomeOf(d, row), b = document.createElement("button");
    b.type = "button"; b.dataset.row = row; b.style.borderLeftColor = shade(outcome.colour);
    b.textContent = `${i}: ${named(d.decision[row]).replace("landmark ", "")} ${outcome.key ? outcome.name : ""}`;
    b.setAttribute("aria-pressed", row === S.row);
    b.addEventListener("click", () => { S.row = row === S.row ? -1 : row; play(false); changed(); });
    return b;
  }));
  if (held) { const again = document.querySelector(`#list button[data-row="${held}"]`); if (again) again.focus(); }
  if (to === from) $$("list").textContent = run.decides ? "No observations." : run.loops && run.loops.length ? "A laser log: the map shows key poses and loop closures." : "This run makes no decisions.";
  $$("inspected").innerHTML = S.row >= 0 ? described(run, d, S.row, from) : to > from ? '<p class="note">Click on an observation, here or in the map.</p>' : "";
  drawMatching(run, from, to);
}
inspect.last = 0;

function gateWords() {
  const head = recording.head;
  return head.gate === null ? "no gate" : `d² < ${head.gate.toFixed(2)} (${head.gates[0]})`;
}

function described(run, d, row, from) {
  const head = recording.head, outcome = outcomeOf(d, row), point = recording.of("point");
  const trueId = recording.column("true_id"), labels = recording.column("label"), right = d.right ? d.right[row] : NaN;
  const rightName = !d.right ? "" : right >= 0 ? `landmark ${right}` : "none in the map";
  const facts = [
    ["measured", `${point[0][row].toFixed(3)} m ahead, ${Math.abs(point[1][row]).toFixed(3)} m to the ${point[1][row] < 0 ? "right" : "left"}`],
    [`${run.name} (${phaseOf(run)})`, `${named(d.decision[row])} <b style="color:${shade(outcome.colour)}">${outcome.key ? outcome.name : ""}</b>`],
  ];
  if (d.right) facts.push(["right", `${rightName}${trueId ? (trueId[row] === -1 ? " (clutter)" : ` (true id ${trueId[row]})`) : ""}`]);
  if (labels) facts.push(["label", labels[row] < 0 ? "none" : labels[row]]);
  let html = `<h2 id="which">Frame ${S.frame}, observation ${row - from}</h2><table id="facts-table"><tbody>${facts.map(([a, b]) => `<tr><th scope="row">${a}</th><td>${b}</td></tr>`).join("")}</tbody></table>`;
  const candidates = candidatesOf(recording, run.key, row);
  if (candidates.length) {
    const inside = (x, t) => t === null || x < t ? "inside" : "outside";
    html += `<table id="candidates"><caption>Candidates: ${gateWords()}${head.new_gate === null ? "" : `; new only outside ${head.new_gate.toFixed(2)} (${head.gates[1]}) of all`}</caption><thead><tr><th>landmark</th><th>d²</th><th>gate</th><th></th></tr></thead><tbody>${
      candidates.map((k) => `<tr data-number="${k.number}" data-d2="${k.d2}"><td>${k.number}</td><td>${k.d2 < 1e4 ? k.d2.toPrecision(4) : k.d2.toExponential(2)}</td><td>${inside(k.d2, head.gate)}</td><td>${[k.number === d.decision[row] ? "chosen" : "", k.number === right ? "right" : ""].filter(Boolean).join(", ")}</td></tr>`).join("")}</tbody></table>`;
    html += methodsTable(run, row, right, d);
  } else {
    html += `<p class="note">${run.candidates ? "No candidates." : run.phases.includes("online") ? "Candidates were not recorded for this run." : "A batch smoother makes no decisions; see the run whose decisions it uses."}</p>`;
  }
  return html;
}

/** Decision of a method about an observation, from the expectation of this run. */
function decidedBy(run, row, w) {
  const made = recording.of(run.key + "method_decision");
  return made ? made[w][row] + recording.column(run.key + "decision")[row] : NOT_ASKED;
}

function methodsTable(run, row, right, d) {
  const names = recording.head.methods;
  if (!names.some((_, w) => decidedBy(run, row, w) !== NOT_ASKED)) return '<p class="note">Decisions of other methods were not recorded: the log is long, and labels decided.</p>';
  const verdict = (n) => !d.right || n < SINGULAR + 1 ? "" : n === right || (n < 0 && right < 0) ? "right" : "wrong";
  const lines = names.map((name, w) => { const n = decidedBy(run, row, w); return `<tr data-method="${name}" data-decision="${n}"><td>${name}</td><td>${named(n)}</td><td>${verdict(n)}</td></tr>`; });
  return `<table id="methods"><caption>Decisions of each method from the same expectation</caption><tbody>${lines.join("")}</tbody></table>
    <label>Picture: decisions by <select id="method">${["", ...names].map((n) => `<option value="${n}"${n === S.method ? " selected" : ""}>${n || `this run (${run.association})`}</option>`).join("")}</select></label>`;
}
