/* Operations on whole matrices, given by their elements column by column, without those that are zero by structure. */
// As fmin and fmax of C: a number rather than NaN.
const least = (a, b) => a <= b || b !== b ? a : b;
const most = (a, b) => a >= b || b !== b ? a : b;
const each = (f, a) => a.map((x) => f(x));
const pairwise = (f, a, b) => a.length >= b.length
  ? a.map((x, i) => f(x, b[b.length === 1 ? 0 : i])) : b.map((y) => f(a[0], y));
const transposed = (a, rows) => a.map((_, i) => a[Math.floor(i / (a.length / rows)) + rows * (i % (a.length / rows))]);
/** z + x y; x has as many rows as given, and y holds the elements in rows `row`, those of column j from `start[j]`. */
function product(z, x, y, rows, start, row) {
  const sum = z.slice();
  for (let j = 0; j + 1 < start.length; j++) {
    for (let k = start[j]; k < start[j + 1]; k++) {
      for (let i = 0; i < rows; i++) sum[i + j * rows] += x[i + row[k] * rows] * y[k];
    }
  }
  return sum;
}
/** The results of a function for each column of its arguments, side by side. */
function mapped(f, count, ...all) {
  const results = [];
  for (let k = 0; k < count; k++) {
    f(...all.map((a) => a.slice(k * a.length / count, (k + 1) * a.length / count)))
      .forEach((one, i) => { (results[i] ||= []).push(...one); });
  }
  return results;
}
