"""Text of a controller in C99: header, source, test program and page.

$p and $P stand for the name of the controller in small and in capital letters.
"""

HEADER = """/* $title. Written by flexman export c; see README.md. */
#ifndef ${P}_H
#define ${P}_H

#define ${P}_JOINTS $joints
#define ${P}_READINGS $size
#define ${P}_PERIOD $period /* s; control period */

/* $holding_reason */
#define ${P}_HOLDING_PERIODS $holding_periods

/* Status of a control period and of a move, by its worst number: within its range, beyond it, NaN or infinite. A step
   before the reset, or after a reset that refused its move, has no move. */
enum { ${P}_GOOD, ${P}_OUT_OF_RANGE, ${P}_NOT_FINITE, ${P}_NO_MOVE };

/* Index of the first value of each reading. */
enum {
$readings
};

/* Tables of a move; after the last row of a table with rows its last row holds. */
typedef struct {
    int rows;
$tables
} ${p}_move;

/* State of the controller; change it only by the functions below. */
typedef struct {
    const ${p}_move *move;
    int row, started, phase;
    int refused; /* consecutive periods with a bad reading; nothing else changes in them */
    double torque[${P}_JOINTS]; /* N m; torques of the last good period */
$memory
} ${p}_state;

extern const double ${p}_torque_limit[${P}_JOINTS]; /* N m */
extern const double ${p}_range[${P}_READINGS]; /* largest magnitude of each reading */
extern const ${p}_move ${p}_exported; /* move from $start to $goal rad */

/* Start a move, at rest at its start; return its status. A move that is not good is refused. */
int ${p}_reset(${p}_state *state, const ${p}_move *move);

/* Compute the motor torques (N m) of a control period from its readings; call once in every period. Return the status.
   If it is not 0 (good), the state remains unchanged but for the number of refused periods, and the torques are those
   of a refused period: $refused_torques. */
int ${p}_step(${p}_state *state, const double readings[${P}_READINGS], double torque[${P}_JOINTS]);

#endif
"""

SOURCE = """/* $title. Written by flexman export c; see README.md. */
#include "$p.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stddef.h>

#if defined __FAST_MATH__ || defined _M_FP_FAST || (defined __FINITE_MATH_ONLY__ && __FINITE_MATH_ONLY__)
#error "this option of the compiler removes the checks for NaN: compile without -ffast-math and -ffinite-math-only"
#endif

#define N ${P}_JOINTS
#define LARGEST $largest /* of the numbers of a move */
$sizes

$constants

const ${p}_move ${p}_exported = {
    $rows,
$initial
};

static double clip(double value, double most)
{
    return value < -most ? -most : value > most ? most : value;
}

/* Return the larger one of a status and that of a number. */
static int worst(int status, double value, double most)
{
    const int own = fabs(value) <= most && fabs(value) <= DBL_MAX ? ${P}_GOOD
        : fabs(value) <= DBL_MAX ? ${P}_OUT_OF_RANGE : ${P}_NOT_FINITE;
    return own > status ? own : status;
}

${dot}${weight}int ${p}_reset(${p}_state *state, const ${p}_move *move)
{
    static const ${p}_state zero;
    int status = move == NULL ? ${P}_NO_MOVE : move->rows > 0 ? ${P}_GOOD : ${P}_OUT_OF_RANGE;
    *state = zero;
$checks    if (status == ${P}_GOOD)
        state->move = move;
    return status;
}

int ${p}_step(${p}_state *state, const double readings[${P}_READINGS], double torque[${P}_JOINTS])
{
    const ${p}_move *move = state->move;
    int status = move == NULL ? ${P}_NO_MOVE : ${P}_GOOD;
    double base[N] = {0.0}, command[N] = {0.0};
    for (int i = 0; i < ${P}_READINGS; i++)
        status = worst(status, readings[i], ${p}_range[i]);
    if (status != ${P}_GOOD) {
        state->refused += state->refused < INT_MAX;
        for (int i = 0; i < N; i++)
            torque[i] = 0.0;
${hold}        return status;
    }
    /* The tables are functions of time: their rows go on in refused periods. */
    const int left = move->rows - 1 - state->row;
    const int row = state->row + (state->refused < left ? state->refused : left);
$step
    for (int i = 0; i < N; i++)
        torque[i] = state->torque[i] = clip(base[i] + command[i], 1.0) * ${p}_torque_limit[i];
    state->row = row + 1 < move->rows ? row + 1 : row;
    state->refused = 0;
    state->started = 1;
    return status;
}
"""

DOT = """/* Return the product of a row of n numbers with a vector of n numbers. */
static double dot(int n, const double *row, const double *vector)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += row[i] * vector[i];
    return sum;
}

"""

CHECK = """    for (int i = 0; status == ${P}_GOOD && i < $count; i++)
        status = worst(status, move->$name[i], LARGEST);
"""

WEIGHT = """/* Turn a vector by an angle about an axis of unit length. */
static void rotate(const double *about, double angle, const double *vector, double *result)
{
    const double cosine = cos(angle), sine = sin(angle), along = (1.0 - cosine) * dot(3, about, vector);
    for (int j = 0; j < 3; j++) {
        const int k = (j + 1) % 3, l = (j + 2) % 3;
        result[j] = cosine * vector[j] + sine * (about[k] * vector[l] - about[l] * vector[k]) + along * about[j];
    }
}

/* Compute the torques (N m) that hold the weight of the rigid arm at motor angles (rad). */
static void hold_weight(const double *angles, double *torque)
{
    double down[N][3], moment[3] = {0.0, 0.0, 0.0}, other[3];
    for (int i = 0; i < N; i++) { /* acceleration of gravity in the frame of each link */
        const double *before = i ? down[i - 1] : gravity;
        for (int j = 0; j < 3; j++)
            other[j] = mount[9 * i + j] * before[0] + mount[9 * i + 3 + j] * before[1]
                + mount[9 * i + 6 + j] * before[2];
        rotate(axis + 3 * i, -angles[i], other, down[i]);
    }
    for (int i = N - 1; i >= 0; i--) { /* first moment of mass of the outboard arm about each joint */
        for (int j = 0; j < 3; j++)
            moment[j] += outboard_moment[3 * i + j];
        torque[i] = 0.0;
        for (int j = 0; j < 3; j++) {
            const int k = (j + 1) % 3, l = (j + 2) % 3;
            torque[i] += axis[3 * i + j] * (down[i][k] * moment[l] - down[i][l] * moment[k]);
        }
        torque[i] *= driven[i]; /* 0 for a passive joint */
        rotate(axis + 3 * i, angles[i], moment, other);
        for (int j = 0; j < 3; j++)
            moment[j] = dot(3, mount + 9 * i + 3 * j, other);
    }
}

"""

HOLD = """        if (state->started && state->refused <= ${P}_HOLDING_PERIODS) {
            hold_weight(state->posture, torque);
            for (int i = 0; i < N; i++)
                torque[i] = clip(torque[i] / ${p}_torque_limit[i], 1.0) * ${p}_torque_limit[i];
        }
"""

POSTURE = """
    for (int i = 0; i < N; i++)
        state->posture[i] = $angle;
"""

MAIN = """/* Compare torques for recorded readings with those of Python, and check that bad readings are refused. The
   exit status is 0 for equal torques without errors. With the argument time: print the durations of 10^6 steps. */
#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#include "$p.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define PERIODS $periods
#define STEPS 1000000
$arrays
static double durations[STEPS]; /* ns; each with one reading of the clock */

static int compare(const void *first, const void *second)
{
    const double difference = *(const double *)first - *(const double *)second;
    return (difference > 0.0) - (difference < 0.0);
}

/* Print the durations of steps by a clock; move and readings are repeated. Pauses as in a control loop: Linux halts a
   real-time thread without pauses for 50 ms in every second. */
static void print_durations(const char *name, clockid_t clock)
{
    const int cycle = ${p}_exported.rows > PERIODS ? ${p}_exported.rows : PERIODS;
    ${p}_state state;
    double torque[${P}_JOINTS];
    struct timespec start, end;
    const struct timespec pause = {0, 1000000};
    for (int k = 0; k < STEPS; k++) {
        if (k % 500 == 0)
            nanosleep(&pause, NULL);
        if (k % cycle == 0)
            ${p}_reset(&state, &${p}_exported);
        clock_gettime(clock, &start);
        ${p}_step(&state, readings + k % PERIODS * ${P}_READINGS, torque);
        clock_gettime(clock, &end);
        durations[k] = 1e9 * (double)(end.tv_sec - start.tv_sec) + (double)(end.tv_nsec - start.tv_nsec);
    }
    qsort(durations, STEPS, sizeof *durations, compare);
    printf("%s time of a step: longest %.0f ns, 99.9 %% %.0f ns, median %.0f ns\\n", name, durations[STEPS - 1],
           durations[STEPS - STEPS / 1000 - 1], durations[STEPS / 2]);
}

/* Return the number of wrong status, torques and states in periods with a bad reading. A state is wrong if more than
   its number of refused periods has changed. */
static int count_wrong(const ${p}_state *before, const double *good)
{
    const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY, 1e308, -1e308, 0.0};
    const int kinds = (int)(sizeof values / sizeof *values);
    int wrong = 0;
    for (int i = 0; i < kinds * ${P}_READINGS; i++) {
        double bad[${P}_READINGS], torque[${P}_JOINTS];
        const int place = i / kinds, kind = i % kinds;
        ${p}_state state;
        memcpy(&state, before, sizeof state); /* with its padding */
        memcpy(bad, good, sizeof bad);
        bad[place] = kind + 1 < kinds ? values[kind] : nextafter(${p}_range[place], DBL_MAX);
        for (int k = 0; k < ${P}_HOLDING_PERIODS + 2; k++) {
            wrong += ${p}_step(&state, bad, torque) != (kind < 3 ? ${P}_NOT_FINITE : ${P}_OUT_OF_RANGE);
            for (int j = 0; j < ${P}_JOINTS; j++) {
                const double most = k < ${P}_HOLDING_PERIODS && before->started ? ${p}_torque_limit[j] : 0.0;
                wrong += !(fabs(torque[j]) <= most);
            }
        }
        state.refused = before->refused;
        wrong += memcmp(&state, before, sizeof state) != 0;
    }
    return wrong;
}

int main(int count, char **arguments)
{
    static ${p}_state state;
    double torque[${P}_JOINTS], largest = 0.0;
    int wrong = 0;
    if (count > 1 && strcmp(arguments[1], "time") == 0) {
        print_durations("wall", CLOCK_MONOTONIC);
        print_durations("CPU", CLOCK_THREAD_CPUTIME_ID);
        return 0;
    }
    wrong += ${p}_step(&state, readings, torque) != ${P}_NO_MOVE;
    wrong += ${p}_reset(&state, &${p}_exported) != ${P}_GOOD;
    for (int k = 0; k < PERIODS; k++) {
        if (k == 0 || k == PERIODS / 2)
            wrong += count_wrong(&state, readings + k * ${P}_READINGS);
        wrong += ${p}_step(&state, readings + k * ${P}_READINGS, torque) != ${P}_GOOD;
        for (int i = 0; i < ${P}_JOINTS; i++)
            largest = fmax(largest, fabs(torque[i] - expected[k * ${P}_JOINTS + i]) / ${p}_torque_limit[i]);
    }
    printf("%d periods, largest difference %.3g of the torque limit, state %u bytes\\n", PERIODS, largest,
           (unsigned)sizeof state);
    printf("bad readings: %d errors of status, torques or state\\n", wrong);
    return largest <= 1e-6 && wrong == 0 ? 0 : 1;
}
"""

README = """# $title

C99 without memory allocation; it needs `math.h` only. All that changes is in `${p}_state`, so that several controllers
can run. Test it on your computer: `cc -std=c99 -O2 main.c $p.c -lm -o test && ./test`; `./test time` prints the longest
of 10^6 steps (POSIX).

- `${p}_reset(&state, &${p}_exported)` starts the move from $start to $goal rad, with tables in `${p}_move`. For
  another move, export again with `--start` and `--goal`, or compute the tables and pass them to `${p}_reset`. It
  returns 0, or the status of a move with a number that is not finite or beyond $largest, which it refuses.
- `${p}_step(&state, readings, torque)` is called every $period s, with the readings of that time. It returns 0, and the
  motor torques in N m, at most $limits.

Environment: $environment. Angles in rad, lengths in m, torques in N m.$note

| reading | values of `readings` | unit | largest magnitude |
| --- | --- | --- | --- |
$table

`angle_errors` are goal minus motor angles; `goal_rates` are zero for a fixed goal. `state` has coordinates and rates in
the order of `states` in `flexman export matlab`. `fine_NAME` is arcsinh of NAME over a scale, see the sensor `fine`.

## Bad readings

`${p}_step` checks all readings before it changes its state. It refuses a period with a reading that is not finite, or
beyond its largest magnitude (`${p}_range`), and returns the status of the worst one:

| status | value | meaning |
| --- | --- | --- |
| `${P}_GOOD` | 0 | all readings are within their ranges |
| `${P}_OUT_OF_RANGE` | 1 | a reading is finite and beyond its range |
| `${P}_NOT_FINITE` | 2 | a reading is NaN or infinite |
| `${P}_NO_MOVE` | 3 | there was no `${p}_reset`, or it refused its move |

- Torques of a refused period: $refused_in_page.
- The state remains unchanged but for the number of refused periods, `state.refused`: estimates of a Kalman filter,
  histories, moving averages, the held command of a policy and the phase of its action repeat are those of the last good
  period, from which the next good period continues.
- Time goes on in the tables of the move: the next good period reads the row of its own time, since a moving goal and
  other machines go on, too.
- Stop the arm, for instance by its brakes, if the status is not 0 in several consecutive periods, and start again with
  `${p}_reset`. The torques of refused periods do not damp the motion of the arm.

The checks need the arithmetic of IEEE 754: `$p.c` does not compile with `-ffast-math` or `-ffinite-math-only`. The test
program gives NaN, infinities, 1e308 and the next number beyond the range as each of the readings. The same behaviour in
Python is that of `flexman_gym.control.RangeCheckedController`.
"""

LINEAR_NOTE = """ The Kalman filter and the regulator are linear about the goal: use it near the goal."""

ZERO_TORQUES = "zero"
HOLDING_TORQUES = (
    "in at most {P}_HOLDING_PERIODS consecutive periods those that hold the weight of the rigid arm at the last good "
    "posture, then zero; zero before the first good period"
)
HOLDING_REASON = (
    "Largest number of consecutive periods with holding torques and without good readings: {seconds:g} s, in which a "
    "body falls freely by {fall:g} of the reach of the arm, {reach:g} m. The torques do not follow the arm."
)
NO_HOLDING_REASON = "The controller compensates no weight: torques of a refused period are zero."
