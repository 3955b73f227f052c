/* The control step of many rows, for a CPU and, as CUDA, for a GPU: the part that CasADi does not generate.
   Arrays have the shape (field, row), so that neighbouring threads read neighbouring numbers. `real` is float or double.
*/
typedef unsigned long long u64;
typedef long long i64;
#ifdef __CUDACC__
#define FN static __device__ __forceinline__
#define SLOW static __device__ __noinline__
#define ROWS(name, ...) extern "C" __global__ void __launch_bounds__(THREADS) name(i64 n, __VA_ARGS__)
#define EACH_ROW i64 i = (i64)blockIdx.x * THREADS + threadIdx.x; if (i < n)
#define ROLLED _Pragma("unroll 1")
#else
#include <math.h>
#define FN static inline
#define SLOW static
#define ROWS(name, ...) void name(i64 n, __VA_ARGS__)
#define EACH_ROW for (i64 i = 0; i < n; ++i)
#define ROLLED
#endif
#ifdef SINGLE
typedef float real;
#define R(x) ((float)((x) == 1e-200 ? 1e-30 : (x))) /* the smallest square of `lifting` */
#define OF(name) name##f
#else
typedef double real;
#define R(x) (x)
#define OF(name) name
#endif
#if defined(__CUDACC__) && defined(SINGLE) /* the GPU's own functions, good to 5e-7 after the reduction to [-pi, pi] */
FN float turned(float x) {
  float k = rintf(x * 0.159154943f);
  return fmaf(k, 1.74845553e-7f, fmaf(k, -6.28318548f, x));
}
FN float q_sin(float x) { return __sinf(turned(x)); }
FN float q_cos(float x) { return __cosf(turned(x)); }
FN float q_log(float x) { return __logf(x); }
#else
FN real q_sin(real x) { return OF(sin)(x); }
FN real q_cos(real x) { return OF(cos)(x); }
FN real q_log(real x) { return OF(log)(x); }
#endif
FN real q_sqrt(real x) { return OF(sqrt)(x); }
FN real q_asin(real x) { return OF(asin)(x); }
FN real q_atan2(real y, real x) { return OF(atan2)(y, x); }
FN real q_exp(real x) { return OF(exp)(x); }
FN real q_expm1(real x) { return OF(expm1)(x); }
FN real q_floor(real x) { return OF(floor)(x); }
FN real q_abs(real x) { return OF(fabs)(x); }
FN real q_min(real x, real y) { return OF(fmin)(x, y); }
FN real q_max(real x, real y) { return OF(fmax)(x, y); }
FN real q_sign(real x) { return (real)((x > 0) - (x < 0)); }

/* The environment rounds actions to float32. gcc 12 drops a plain conversion when it vectorises this with -O2. */
FN real rounded(real x) {
#ifdef __CUDACC__
  return (float)x;
#else
  volatile float y = (float)x;
  return y;
#endif
}

/* The random streams of core/streams.py. A float has fewer bits: their first 23. */
FN u64 mix(u64 x) {
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31);
}
FN u64 derive(u64 key, u64 number) { return mix(mix(key) + number * 0x9E3779B97F4A7C15ULL); }
FN real uniform(u64 key, u64 index) {
  u64 bits = mix(key + (index + 1) * 0x9E3779B97F4A7C15ULL);
#ifdef SINGLE
  return ((float)(unsigned)(bits >> 41) + 0.5f) * 0x1p-23f;
#else
  return ((double)(i64)(bits >> 12) + 0.5) * 0x1p-52;
#endif
}

#define SOME(size) ((size) > 0 ? (size) : 1)
#define LOAD(to, from, size) for (int f = 0; f < (size); ++f) (to)[f] = (from)[f * n + i]
#define STORE(to, from, size) for (int f = 0; f < (size); ++f) (to)[f * n + i] = (from)[f]

// GENERATED

/* Return the place in the queue of the action that acts in a substep: the newest that has arrived. */
FN int acting_slot(const real *arrival, int substep) {
  int slot = N_SLOTS - 1;
#if N_DRAWN
  for (int j = 0; j < N_SLOTS; ++j) slot -= arrival[j] > (real)substep;
#else
  slot -= N_DELAY > substep ? (N_DELAY - substep + N_SUBSTEPS - 1) / N_SUBSTEPS : 0;
  (void)arrival;
#endif
  return slot;
}

/* Write the action that acts in a substep, and hover before the first. */
FN void choose(const real *queue, int slot, real *acting) {
  for (int c = 0; c < 4; ++c) {
    acting[c] = 0;
    for (int j = 0; j < N_SLOTS; ++j) acting[c] = j == slot ? queue[4 * j + c] : acting[c];
  }
}

#ifndef MOTION
/* What is not a number stays so, and ends the episode. */
FN real limited(real a) { return a < -1 ? -1 : a > 1 ? 1 : a; }

/* Start the next episode of a row. */
SLOW void begin(i64 n, i64 i, const i64 *seed, i64 *episode, int *clock, real *memory, real *out) {
  real u[START_DRAWS], m[N_MEMORY] = {0}, observation[N_OBSERVATION];
  episode[i] += 1;
  clock[i] = 0;
  start_draws(derive((u64)seed[i], (u64)episode[i]), 0, m, u);
  start(u, m, observation);
  STORE(memory, m, N_MEMORY);
  STORE(out, observation, N_OBSERVATION);
}

ROWS(reset_rows, const unsigned char *mask, const i64 *seed, i64 *episode, int *clock, real *memory, real *out) {
  EACH_ROW {
    if (mask[i]) begin(n, i, seed, episode, clock, memory, out);
  }
}

/* What a step draws for an action: `out` has the rows of the action after the actuators, when it acts (in substeps from
   now), loop and wind. */
ROWS(draw_rows, const real *action, i64 by_row, i64 by_column, const i64 *seed, const i64 *episode, const int *clock,
     const real *memory, real *out) {
  EACH_ROW {
    real m[N_MEMORY], u[SOME(ACTUATE_DRAWS)], v[SOME(BLOW_DRAWS)], given[4], acted[4], late = 0, act[SOME(N_ACT)];
    real loop[SOME(N_LOOP)], force[9], air[N_AIR], wind[SOME(N_WIND)], blown[N_BLOWN];
    LOAD(m, memory, N_MEMORY);
    u64 key = derive((u64)seed[i], (u64)episode[i]);
    real time = (real)clock[i];
    for (int c = 0; c < 4; ++c) given[c] = limited(action[i * by_row + c * by_column]);
    actuate_draws(key, (u64)clock[i], m, u);
    actuate(given, m, &time, u, acted, &late, act, loop);
    for (int f = 0; f < N_LOOP; ++f) m[N_LOOP_AT + f] = loop[f];
    if (N_ARRIVAL > 0) late = q_max(late, m[N_ARRIVAL_AT + SOME(N_ARRIVAL) - 1]);
    blow_draws(key, (u64)clock[i], m, v);
    blow(m, &time, v, force, air, wind, blown);
    STORE(out, acted, 4);
    STORE(out + 4 * n, &late, 1);
    STORE(out + 5 * n, loop, N_LOOP);
    STORE(out + (5 + N_LOOP) * n, blown, N_BLOWN);
  }
}

/* `out` has the rows observation, reward and tracking error, `last` the last observation of an episode that ends,
   `ends` the rows terminated and truncated. */
ROWS(step_rows, const real *action, i64 by_row, i64 by_column, int limit, const i64 *seed, i64 *episode, int *clock,
     real *memory, real *out, real *final, unsigned char *ends) {
  EACH_ROW {
    real m[N_MEMORY], u[SOME(ACTUATE_DRAWS)], v[SOME(BLOW_DRAWS)], w[SOME(FINISH_DRAWS)], given[4], late;
    real queue[4 * N_SLOTS], arrival[N_SLOTS], acting[4], force[9], air[N_AIR], x[N_X], after[N_X];
    real act[SOME(N_ACT)], wind[SOME(N_WIND)], sense[SOME(N_SENSE)], jump[SOME(N_JUMP)], loop[SOME(N_LOOP)];
    real observation[N_OBSERVATION], reward, ended, error[3], blown[N_BLOWN];
    LOAD(m, memory, N_MEMORY);
    int now = clock[i];
    u64 key = derive((u64)seed[i], (u64)episode[i]);
    real time = (real)now;
    for (int c = 0; c < 4; ++c) given[c] = limited(action[i * by_row + c * by_column]);
    LOAD(queue, memory + N_QUEUE_AT * n, N_QUEUE);
    LOAD(arrival, memory + N_ARRIVAL_AT * n, N_ARRIVAL);
    actuate_draws(key, (u64)now, m, u);
    actuate(given, m, &time, u, queue + N_QUEUE, &late, act, loop);
    for (int f = 0; f < N_LOOP; ++f) m[N_LOOP_AT + f] = loop[f]; /* until the end of this step */
#if N_DRAWN
    arrival[N_SLOTS - 1] = q_max(late, N_ARRIVAL > 0 ? arrival[SOME(N_ARRIVAL) - 1] : late);
#endif
    for (int c = 0; c < 4; ++c) queue[N_QUEUE + c] = rounded(queue[N_QUEUE + c]);
    blow_draws(key, (u64)now, m, v);
    blow(m, &time, v, force, air, wind, blown);
    for (int f = 0; f < N_X; ++f) x[f] = m[f];
    ROLLED
    for (int k = 0; k < N_SUBSTEPS; ++k) {
      choose(queue, acting_slot(arrival, k), acting);
      substep(m, x, acting, force, air, after);
      for (int f = 0; f < N_X; ++f) x[f] = after[f];
    }
    finish_draws(key, (u64)now, m, w);
    finish(x, queue + N_QUEUE, m, &time, w, after, sense, jump, observation, &reward, &ended, error);
    int is_late = now + 1 >= limit, is_lost = ended != 0;
    STORE(out + N_OBSERVATION * n, &reward, 1);
    STORE(out + (N_OBSERVATION + 1) * n, error, 3);
    ends[i] = (unsigned char)is_lost;
    ends[n + i] = (unsigned char)is_late;
    if (is_late || is_lost) {
      STORE(final, observation, N_OBSERVATION);
      begin(n, i, seed, episode, clock, memory, out);
    } else {
      clock[i] = now + 1;
      STORE(memory, after, N_X);
      STORE(memory + N_ACT_AT * n, act, N_ACT);
      STORE(memory + N_WIND_AT * n, wind, N_WIND);
      STORE(memory + N_SENSE_AT * n, sense, N_SENSE);
      STORE(memory + N_JUMP_AT * n, jump, N_JUMP);
      STORE(memory + N_QUEUE_AT * n, queue + 4, N_QUEUE);
      for (int f = 0; f < N_ARRIVAL; ++f) arrival[f] = arrival[f + 1] - N_SUBSTEPS;
      STORE(memory + N_ARRIVAL_AT * n, arrival, N_ARRIVAL);
      STORE(out, observation, N_OBSERVATION);
    }
  }
}

#else
/* The motion alone. `path` gets x before each substep; `queue` has the actions under way and then the new one, `arrival`
   when each acts, with a drawn loop. */
ROWS(move_rows, const real *x0, const real *queue0, const real *arrival0, const real *wind0, const real *p0,
     const real *loop0, real *path, real *x1) {
  EACH_ROW {
    real x[N_X], after[N_X], queue[4 * N_SLOTS], arrival[N_SLOTS], wind[N_BLOWN], p[9], loop[SOME(N_LOOP)], force[9];
    real air[N_AIR], acting[4];
    LOAD(x, x0, N_X);
    LOAD(queue, queue0, 4 * N_SLOTS);
    LOAD(arrival, arrival0, N_DRAWN * N_SLOTS);
    LOAD(wind, wind0, N_BLOWN);
    LOAD(p, p0, 9);
    LOAD(loop, loop0, N_LOOP);
    drag(x, wind, p, force, air);
    ROLLED
    for (int k = 0; k < N_SUBSTEPS; ++k) {
      STORE(path + (i64)k * N_X * n, x, N_X);
      choose(queue, acting_slot(arrival, k), acting);
      move(x, acting, force, air, p, loop, after);
      for (int f = 0; f < N_X; ++f) x[f] = after[f];
    }
    outputs(x, x + 6);
    STORE(x1, x, N_X);
  }
}

/* The product with the transposed Jacobian of `move_rows` with respect to x0 and the queue. */
ROWS(move_rows_back, const real *path, const real *x1, const real *queue0, const real *arrival0, const real *wind0,
     const real *p0, const real *loop0, const real *bar1, real *bar0, real *bar_queue0) {
  EACH_ROW {
    real x[N_X], queue[4 * N_SLOTS], arrival[N_SLOTS], wind[N_BLOWN], p[9], loop[SOME(N_LOOP)], force[9], air[N_AIR];
    real acting[4], bar[N_X], before[N_X], bar_acting[4], bar_force[9], total[9], bar_queue[4 * N_SLOTS];
    LOAD(queue, queue0, 4 * N_SLOTS);
    LOAD(arrival, arrival0, N_DRAWN * N_SLOTS);
    LOAD(wind, wind0, N_BLOWN);
    LOAD(p, p0, 9);
    LOAD(loop, loop0, N_LOOP);
    LOAD(bar, bar1, N_X);
    for (int f = 0; f < 9; ++f) total[f] = 0;
    for (int f = 0; f < 4 * N_SLOTS; ++f) bar_queue[f] = 0;
    LOAD(x, x1, N_X);
    outputs_back(x, bar + 6, before);
    for (int f = 0; f < N_X; ++f) bar[f] = (f < 6 || f >= 12 ? bar[f] : 0) + before[f];
    LOAD(x, path, N_X);
    drag(x, wind, p, force, air);
    ROLLED
    for (int k = N_SUBSTEPS - 1; k >= 0; --k) {
      int slot = acting_slot(arrival, k);
      LOAD(x, path + (i64)k * N_X * n, N_X);
      choose(queue, slot, acting);
      move_back(x, acting, force, air, p, loop, bar, before, bar_acting, bar_force);
      for (int f = 0; f < N_X; ++f) bar[f] = before[f];
      for (int f = 0; f < 9; ++f) total[f] += bar_force[f];
      for (int j = 0; j < N_SLOTS; ++j)
        for (int c = 0; c < 4; ++c) bar_queue[4 * j + c] += j == slot ? bar_acting[c] : 0;
    }
    drag_back(x, wind, p, total, before);
    for (int f = 0; f < N_X; ++f) bar[f] += before[f];
    STORE(bar0, bar, N_X);
    STORE(bar_queue0, bar_queue, 4 * N_SLOTS);
  }
}
#endif
