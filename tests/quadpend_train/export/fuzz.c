/* Random steps of a supervised policy, `policy.c`: whatever it gets, its promises hold. Prints the first broken one.
 *
 *     cc -std=c99 -O2 -I FOLDER fuzz.c FOLDER/policy.c -lm && ./a.out 1000000 */
#include "policy.h"

#include <stdio.h>
#include <stdlib.h>

static uint32_t state = 1;
static uint32_t draw(uint32_t below) { /* xorshift32 */
  state ^= state << 13, state ^= state >> 17, state ^= state << 5;
  return state % below;
}
static policy_real uniform(void) { return (policy_real)draw(2000001) / 1000000 - 1; }

static policy_real strange(void) {
  policy_real infinite = 2, values[8] = {0, -1, 3, (policy_real)1e7, (policy_real)-1e30};
  for (int i = 0; i < 12; ++i) infinite *= infinite;
  values[5] = infinite, values[6] = -infinite, values[7] = infinite - infinite;
  return values[draw(8)];
}

#define PROMISE(holds) \
  if (!(holds)) { printf("step %ld: %s\n", step, #holds); return 1; }

int main(int count, char **arguments) {
  long steps = count > 1 ? atol(arguments[1]) : 1000, flown = 0, kills = 0;
  policy_supervisor s;
  policy_limits *most = &s.limits;
  policy_real *limits[9] = {&most->pole_tilt, &most->body_tilt, &most->distance, &most->height[0], &most->speed,
                            &most->age,       &most->caution,   most->set_point,  most->yaw};
  policy_supervisor_reset(&s);
  policy_real point[3] = {0, 0, 2};
  for (long step = 0; step < steps; ++step) {
    policy_measurement seen = {{point[0], point[1], point[2]}, {1, 0, 0, 0}, {0, 0, 1}, 0};
    policy_reference wanted = {{{0, 0, 2}}, {0, 0, 0}, policy_POLE};
    policy_command command;
    int damage = (int)draw(100), is_killed = s.stage == policy_KILL, has_reference = draw(4) > 0;
    for (int i = 0; i < 3; ++i) point[i] += uniform() / 2000;
    if (draw(400) == 0 || (is_killed && draw(5) == 0)) {
      policy_supervisor_reset(&s), is_killed = 0;
      point[0] = point[1] = 0, point[2] = 2;
    }
    if (draw(50) == 0 || s.stage == policy_OFF) s.request = draw(60) ? (int)draw(2) + 1 : (int)draw(6) - 1;
    if (damage == 0) ((policy_real *)&seen)[draw(11)] = strange();
    if (damage == 1) ((policy_real *)&wanted)[draw(26)] = strange();
    if (damage == 2) ((policy_real *)&seen)[draw(11)] += uniform();
    if (damage == 3) for (int i = 0; i < 11; ++i) ((policy_real *)&seen)[i] = strange();
    if (draw(200) == 0) policy_go_to(&s, draw(5) ? point : seen.position, uniform() * 9);
    if (draw(5000) == 0) *limits[draw(9)] = strange();
    uint32_t status = policy_supervise(&s, damage == 4 ? NULL : &seen, has_reference ? &wanted : NULL, &command);
    flown += s.stage == policy_FLY, kills += s.stage == policy_KILL && !is_killed;
    PROMISE(command.thrust >= 0 && command.thrust < 1000 && command.thrust == command.thrust)
    for (int i = 0; i < 3; ++i) PROMISE(command.rate[i] < 100 && command.rate[i] > -100)
    PROMISE(!is_killed || s.stage == policy_KILL)
    PROMISE(s.stage != policy_KILL || (command.thrust == 0 && command.rate[0] == 0 && (s.cause & policy_KILLED)))
    PROMISE((s.stage == policy_KILL) == !!(status & policy_KILLED))
    PROMISE(s.stage == policy_KILL || s.stage == s.request || (s.stage == policy_OFF || s.stage == policy_HOLD))
    PROMISE(s.stage != policy_FLY || s.blind <= s.limits.age)
    PROMISE(s.stage != policy_FLY || !(status & (policy_AGE | policy_DIVERGED | policy_HEIGHT | policy_SPEED)))
    PROMISE(damage != 3 || (status & policy_BLIND))
    PROMISE(damage != 4 || (status & policy_BLIND))
    PROMISE(s.innovation == s.innovation && s.innovation >= 0)
    for (int k = 0; k < 7; ++k) {
      for (int i = 0; i < 3; ++i) PROMISE(s.reference.derivatives[k][i] == s.reference.derivatives[k][i])
    }
  }
  printf("%ld steps, %ld in flight, %ld kills\n", steps, flown, kills);
  return !(flown > steps / 4 && kills > steps / 10000);
}
