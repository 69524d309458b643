/** @typedef {{ name: string, unit: string, lower: number, upper: number, value: number }} Input */
/** @typedef {{ name: string, unit: string, atLeast: number | null, atMost: number | null, size: number }} Output */
/**
 * Return the results at values of the inputs.
 * @param {Values} [values]
 * @returns {Results}
 * @throws {TypeError} a value that is not a finite number
 * @throws {RangeError} an unknown input, a value outside its bounds, or a result that is not finite
 */
export function evaluate(values = {}) {
  const text = (/** @type {any} */ value) =>
    typeof value === "string" || typeof value === "object" ? JSON.stringify(value) : String(value);
  if (typeof values !== "object" || values === null || Array.isArray(values)) {
    throw new TypeError(`the values are ${text(values)}: give an object from names of inputs to numbers`);
  }
  const known = new Set(inputs.map((input) => input.name));
  for (const name of Object.keys(values)) {
    if (!known.has(name)) throw new RangeError(`there is no input "${name}": use ${[...known].join(", ")}`);
  }
  const x = inputs.map((input) => {
    const { [input.name]: value = input.value } = /** @type {Record<string, number>} */ (values);
    if (typeof value !== "number" || !Number.isFinite(value)) {
      const unit = input.unit ? ` in ${input.unit}` : "";
      throw new TypeError(`${input.name} = ${text(value)} is not a finite number: give one${unit}`);
    }
    const slack = RELAXATION * (input.upper - input.lower);
    if (!(value >= input.lower - slack && value <= input.upper + slack)) {
      const bounds = `between ${input.lower} and ${input.upper}`;
      throw new RangeError(`${input.name} = ${value} ${input.unit} must lie ${bounds}`);
    }
    return [value];
  });
  const found = /** @type {any} */ (computed)(...x);
  /** @type {any} */
  const results = {};
  outputs.forEach((output, k) => {
    if (!found[k].every(Number.isFinite)) throw new RangeError(`"${output.name}" has no finite value here`);
    results[output.name] = output.size > 1 ? found[k] : found[k][0];
  });
  return results;
}
