// The recording grows while the robot drives: new chunks are fetched each second, and the newest frame is shown.
const EVERY = 1000, LATER = 3000;  // ms from answer to request; without an answer
let grids = 0;  // number of the grid on the page
let following = true, shown = 0, plotted = 0, plotting = 0, connected = true;

/** Follow the newest frame, or stay at the present one. */
function follow(on) {
  following = on;
  $$("live").setAttribute("aria-pressed", on);
  if (on) { play(false); newest(); }
}

function newest() { go(recording.frames - 1); shown = S.frame; }

/** Fetch the frames after those that are here; true if the drive ended. */
async function fetched() {
  const from = recording.head ? `chunks/${recording.first + recording.frames}` : "chunks";
  const answer = await fetch(from, { cache: "no-store" });
  if (answer.status === 410) { location.reload(); return new Promise(() => {}); }  // no longer kept: reload
  if (!answer.ok) throw new Error(answer.statusText);
  const { ended, chunks } = await answer.json(), begun = recording.head !== null;
  for (const chunk of chunks) await recording.append(chunk);
  if (!recording.head) return ended;
  if (chunks.length) recording.head.runs.forEach((run, i) => Object.assign(run, { status: chunks.at(-1).runs[i].status, why: chunks.at(-1).runs[i].why }));
  if (!begun) { opened(); prepare(); }
  if (chunks.length) grown(chunks.at(-1));
  if (chunks.length && chunks.at(-1).grids > grids) await fetchGround(chunks.at(-1).grids);
  return ended;
}

/** The newest occupancy grid. */
async function fetchGround(number) {
  const answer = await fetch("grid", { cache: "no-store" });
  if (!answer.ok) return;
  const { png, ...place } = await answer.json();
  const bytes = Uint8Array.from(atob(png), (c) => c.charCodeAt(0));
  ground = { ...place, image: await createImageBitmap(new Blob([bytes], { type: "image/png" })) };
  grids = number; changed();
}

function prepare() {
  for (const radio of document.querySelectorAll("input[name=phase]")) radio.parentElement.hidden = true;
  for (const name of ["wrong-back", "wrong-next"]) $$(name).hidden = true;
  $$("live").hidden = false;
  $$("live").addEventListener("click", () => follow(true));
}

/** More frames than before. */
function grown(chunk) {
  histories.clear();
  $$("slider").max = recording.frames - 1;
  if (!mapView.touched && !S.follow) mapView.fit(worldBox());
  if (following && S.frame !== shown) follow(false);
  if (following) newest();
  const begin = performance.now();
  if (begin - plotted > 20 * plotting) {  // plots may take a twentieth of the time
    fillRuns(); makePlots();
    plotted = performance.now(); plotting = plotted - begin;
  }
  inspect.last = 0; changed();
  show(chunk.now);
}

function show(text) { $$("facts").textContent = text; }

async function ask() {
  let wait = EVERY;
  try {
    const ended = await fetched();
    connected = true;
    if (ended) { show(`The drive has ended. ${recording.frames} frames.`); return; }
    if (!recording.head) show("Waiting for the robot's first answer.");
  } catch (fault) {
    if (connected) show("No connection: the drive has ended or is delayed.");
    connected = false; wait = LATER;
  }
  setTimeout(ask, wait);
}
ask();
