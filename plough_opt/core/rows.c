/* Evaluates a Function for n designs, WIDE of them at a time, by reading its list of operations. An operation is four
   numbers: its code, the register of its result, and the registers of its operands. For an argument of the Function the
   last two are its number and a place in it. A result has the register of its value second, then its number and the
   place in it; a constant has its number third. `arrays` are the arguments and then the results, with a row for each design, and `sizes` the
   lengths of their rows. `memory` has room for WIDE numbers in each register, and for one vector more. */
#define WIDE ${wide}
#define PARTS (WIDE / LANES)
#define OF_PARTS(VALUE) for (int k = 0; k < PARTS; k++) r[k] = VALUE; break;
void rows(int64_t n, int64_t count, const int32_t *operations, const double *constants, const int64_t *sizes,
          int64_t arguments, double *const *arrays, double *memory) {
  V *const registers = (V *)(((uintptr_t)memory + sizeof(V) - 1) / sizeof(V) * sizeof(V));
  for (int64_t first = 0; first < n; first += WIDE) {
    const int64_t many = n - first < WIDE ? n - first : WIDE;
    for (int64_t j = 0; j < count; j++) {
      const int32_t *of = operations + 4 * j;
      V *const r = registers + PARTS * of[1];
      const V *const a = registers + PARTS * of[2], *const b = registers + PARTS * of[3];
      switch (of[0]) {
        case ${input}: {
          const int64_t size = sizes[of[2]];
          const double *from = arrays[of[2]] + first * size + of[3];
          for (int k = 0; k < WIDE; k++) ((double *)r)[k] = from[(k < many ? k : many - 1) * size];
          break;
        }
        case ${output}: {
          const int64_t size = sizes[arguments + of[2]];
          double *to = arrays[arguments + of[2]] + first * size + of[3];
          for (int k = 0; k < many; k++) to[k * size] = ((double *)r)[k];
          break;
        }
        case ${constant}: OF_PARTS((V){0} + constants[of[2]])
${cases}
      }
    }
  }
}
