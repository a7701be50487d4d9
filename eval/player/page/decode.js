// Decode chunks: inflate, join the bytes of each integer, add up the differences (see eval/player/pack.py).
async function inflated(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function decodedColumn(bytes, entry, column) {
  const { rows, columns, size, at, scale } = entry, plane = rows * columns;
  const values = new Float64Array(rows);
  let sum = 0;
  for (let row = 0; row < rows; row++) {
    let where = at + column * rows + row, step = 0;
    for (let byte = 0; byte < size; byte++, where += plane) step |= bytes[where] << (8 * byte);
    const shift = 32 - 8 * size;
    step = (step << shift) >> shift;
    sum = entry.steps ? step : sum + step;
    values[row] = entry.log ? Math.exp(sum * scale) : sum * scale;
  }
  for (const [from, to] of entry.missing) values.fill(NaN, from, to);
  return values;
}

/** A recording: `head` is the first chunk's header, `first` the number of its first frame, `frames` how many there are,
 * `of(name)` the columns of an array, `begins.get(name)` the rows with which its chunks begin. */
class Recording {
  constructor() { this.head = null; this.first = 0; this.frames = 0; this.arrays = new Map(); this.begins = new Map(); }

  /** The next chunk; its rows come after those of the chunks before. */
  async append(chunk) {
    const bytes = await inflated(chunk.data);
    for (const entry of chunk.arrays) {
      const old = this.arrays.get(entry.name), columns = [];
      if (!old) this.begins.set(entry.name, new Set());
      this.begins.get(entry.name).add(old ? old[0].length : 0);
      for (let c = 0; c < entry.columns; c++) {
        const more = decodedColumn(bytes, entry, c);
        if (!old) { columns.push(more); continue; }
        const both = new Float64Array(old[c].length + more.length);
        both.set(old[c]); both.set(more, old[c].length);
        columns.push(both);
      }
      this.arrays.set(entry.name, columns);
    }
    if (!this.head) { this.head = chunk; this.first = chunk.first; }
    this.frames = chunk.first + chunk.frames - this.first;
  }

  of(name) { return this.arrays.get(name) || null; }
  column(name, c = 0) { const found = this.arrays.get(name); return found ? found[c] : null; }
}

/** First place in ascending `values` that is greater than x. */
function after(values, x, from = 0, to = values.length) {
  while (from < to) { const middle = (from + to) >> 1; if (values[middle] <= x) from = middle + 1; else to = middle; }
  return from;
}
const NEW = -1, DISCARD = -2, NOT_ASKED = -3, SINGULAR = -4;
