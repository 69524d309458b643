/* Vector registers of doubles, and functions of them; the compiler drops those that are not used. With two registers
   side by side a processor works on one while it waits for a result of the other. */
#include <math.h>
#include <stdint.h>

#if defined(__AVX512F__)
#define WIDTH 8
#define LETTER e
#elif defined(__AVX2__)
#define WIDTH 4
#define LETTER d
#else
#define WIDTH 2
#define LETTER b
#endif
#ifndef REGISTERS
#define REGISTERS 1
#endif
#define LANES (REGISTERS * WIDTH)
typedef double Register __attribute__((vector_size(8 * WIDTH), aligned(8 * WIDTH)));
typedef double V __attribute__((vector_size(8 * LANES), aligned(8 * LANES)));
typedef int64_t M __attribute__((vector_size(8 * LANES), aligned(8 * LANES)));

static inline V v_pick(M m, V a, V b) { return (V)(((M)a & m) | ((M)b & ~m)); }
static inline V v_min(V a, V b) { return v_pick((a <= b) | (b != b), a, b); }
static inline V v_max(V a, V b) { return v_pick((a >= b) | (b != b), a, b); }
static inline V v_fabs(V a) { return (V)((M)a & INT64_MAX); }
static inline V v_one(M m) { const V one = {0}; return (V)((M)(one + 1.0) & m); }
static inline V v_sign(V a) { return v_one(a > 0.0) - v_one(a < 0.0); }
static inline int any(M m) { int64_t all = 0; for (int k = 0; k < LANES; k++) all |= m[k]; return all != 0; }
#define EACH(NAME) \
  static inline V v_##NAME(V a) { V r; for (int k = 0; k < LANES; k++) r[k] = NAME(a[k]); return r; }
#define EACH_OF_TWO(NAME) \
  static inline V v_##NAME(V a, V b) { V r; for (int k = 0; k < LANES; k++) r[k] = NAME(a[k], b[k]); return r; }
#ifdef VECTOR_LIBRARY
#define JOIN(A, B, C, D) A##B##N##C##D
#define SYMBOL(LETTER, WIDTH, MANGLED) JOIN(_ZGV, LETTER, WIDTH, MANGLED)
typedef union { V all; Register each[REGISTERS]; } Registers;
/* The vector library's names, such as _ZGVdN4v_sin, have a letter for the registers and the number of their lanes. */
#define LIBRARY(NAME) \
  Register SYMBOL(LETTER, WIDTH, v_##NAME)(Register); \
  static inline V v_##NAME(V a) { \
    Registers r = {a}; \
    for (int k = 0; k < REGISTERS; k++) r.each[k] = SYMBOL(LETTER, WIDTH, v_##NAME)(r.each[k]); \
    return r.all; }
#define LIBRARY_OF_TWO(NAME) \
  Register SYMBOL(LETTER, WIDTH, vv_##NAME)(Register, Register); \
  static inline V v_##NAME(V a, V b) { \
    Registers r = {a}, s = {b}; \
    for (int k = 0; k < REGISTERS; k++) r.each[k] = SYMBOL(LETTER, WIDTH, vv_##NAME)(r.each[k], s.each[k]); \
    return r.all; }
#else
#define LIBRARY(NAME) EACH(NAME)
#define LIBRARY_OF_TWO(NAME) EACH_OF_TWO(NAME)
#endif

static inline V gather(const double *from, const int64_t *which) {
  V r; for (int k = 0; k < LANES; k++) r[k] = from[which[k]]; return r; }

EACH(floor) EACH(ceil) EACH(sqrt)
LIBRARY(exp) LIBRARY(expm1) LIBRARY(log) LIBRARY(log1p) LIBRARY(sin) LIBRARY(cos) LIBRARY(tan) LIBRARY(asin)
LIBRARY(acos) LIBRARY(atan) LIBRARY(sinh) LIBRARY(cosh) LIBRARY(tanh) LIBRARY(asinh) LIBRARY(acosh) LIBRARY(atanh)
LIBRARY(erf)
LIBRARY_OF_TWO(atan2) LIBRARY_OF_TWO(hypot) LIBRARY_OF_TWO(pow)
