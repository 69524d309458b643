let seed = 1;
const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
const between = ({ variable, lower, upper, value, log }) =>
  !variable ? value : log ? lower * (upper / lower) ** random() : lower + random() * (upper - lower);
const design = () => MODEL.inputs.map(between), own = engine(MODEL, FUNCTIONS);
const TASKS = {
  move: () => own.evaluate(design()).steps,
  cloud: () => Array.from({ length: 2000 }, () => own.evaluate(design(), { sketch: true })).length,
};
require("readline").createInterface({ input: process.stdin }).on("line", (task) => console.log(TASKS[task]()));
