"""Text of a controller in C99: header, source, test program, page, and the statements of each kind of controller.

$p and $P stand for the name of the controller in small and in capital letters.
"""

HEADER = """/* $title. Written by flexman export c; see README.md. */
#ifndef ${P}_H
#define ${P}_H

#define ${P}_JOINTS $joints
#define ${P}_READINGS $size
#define ${P}_PERIOD $period /* s; control period */

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
    double torque[${P}_JOINTS]; /* N m; torques of the previous period */
$memory
} ${p}_state;

extern const double ${p}_torque_limit[${P}_JOINTS]; /* N m */
extern const ${p}_move ${p}_exported; /* move from $start to $goal rad */

/* Start a move; at rest at its start. */
void ${p}_reset(${p}_state *state, const ${p}_move *move);

/* Compute the motor torques (N m) of a control period from its readings; call once in every period. */
void ${p}_step(${p}_state *state, const double readings[${P}_READINGS], double torque[${P}_JOINTS]);

#endif
"""

SOURCE = """/* $title. Written by flexman export c; see README.md. */
#include "$p.h"

#include <math.h>

#define N ${P}_JOINTS
$sizes

$constants

const ${p}_move ${p}_exported = {
    $rows,
$initial
};

static double clip(double value, double most)
{
    return value < -most ? -most : value > most ? most : value; /* NaN stays NaN */
}

${dot}void ${p}_reset(${p}_state *state, const ${p}_move *move)
{
    static const ${p}_state zero;
    *state = zero;
    state->move = move;
}

void ${p}_step(${p}_state *state, const double readings[${P}_READINGS], double torque[${P}_JOINTS])
{
    const ${p}_move *move = state->move;
    const int row = state->row;
    double base[N] = {0.0}, command[N] = {0.0};
$step
    for (int i = 0; i < N; i++)
        torque[i] = state->torque[i] = clip(base[i] + command[i], 1.0) * ${p}_torque_limit[i];
    state->row = row + 1 < move->rows ? row + 1 : row;
    state->started = 1;
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

SHIFT = """
    /* Input shaping: readings of the goal become readings of the shaped command. */
    double shaped[${P}_READINGS];
    for (int i = 0; i < ${P}_READINGS; i++)
        shaped[i] = readings[i];
$shifts
"""

SHIFTED = """    for (int i = 0; i < $size; i++)
        shaped[${P}_$READING + i] += move->${reading}_shift[$size * row + i];"""

PD = """
    /* PD controller of the motors; single precision at the end as in Python. */
    for (int i = 0; i < N; i++) {
        const double rate = $r[${P}_MOTOR_RATES + i] - $r[${P}_GOAL_RATES + i];
        const double sum = stiffness[i] * $r[${P}_ANGLE_ERRORS + i] - damping[i] * rate$holding;
        base[i] = (float)clip(sum / ${p}_torque_limit[i], 1.0);
    }
"""

LQR = """
    /* Feed-forward and feedback of the state, with gains interpolated along the move. */
    {
        const double position = move->positions[row];
        const int most = GAINS > 2 ? GAINS - 2 : 0, whole = (int)position;
        const int lower = whole < most ? whole : most, upper = lower + 1 < GAINS ? lower + 1 : GAINS - 1;
        for (int i = 0; i < N; i++) {
            const double *first = move->gains + (lower * N + i) * STATES;
            const double *last = move->gains + (upper * N + i) * STATES;
            double sum = move->torques[row * N + i];
            for (int j = 0; j < STATES; j++) {
                const double gain = first[j] + (position - lower) * (last[j] - first[j]);
                sum -= gain * ($r[${P}_STATE + j] - move->states[row * STATES + j]);
            }
            base[i] = clip(sum / ${p}_torque_limit[i], 1.0);
        }
    }
"""

LQG = """
    /* Kalman filter with a fixed gain; deviation from the equilibrium at the goal. */
    {
        double predicted[STATES], error[MEASUREMENTS], input[N];
        for (int i = 0; i < N; i++)
            input[i] = state->started ? state->torque[i] - move->holding[i] : $r[${P}_MOTOR_ANGLES + i] - move->goal[i];
        for (int i = 0; i < STATES; i++)
            predicted[i] = state->started ? dot(STATES, move->A + i * STATES, state->deviation)
                + dot(N, move->B + i * N, input) : dot(N, move->from_angles + i * N, input);
        for (int i = 0; i < MEASUREMENTS; i++)
            error[i] = state->started ? $r[i] - dot(STATES, move->C + i * STATES, move->rest)
                - dot(STATES, move->C + i * STATES, predicted) : 0.0;
        for (int i = 0; i < STATES; i++)
            state->deviation[i] = predicted[i] + dot(MEASUREMENTS, move->L + i * MEASUREMENTS, error);
        for (int i = 0; i < N; i++) {
            const double sum = move->holding[i] - dot(STATES, move->K + i * STATES, state->deviation);
            base[i] = clip(sum / ${p}_torque_limit[i], 1.0);
        }
    }
"""

NETWORK = """
    /* Policy network, once in REPEAT periods; observations and commands in single precision as in Python. */
    if (state->phase == 0) {
        double values[2][WIDTH];
        for (int j = 0; j < OBSERVED; j++) {
            for (int k = HISTORY - 1; k > 0; k--) {
                double *entry = &state->history[k * OBSERVED + j];
                if (!state->started)
                    *entry = readings[j];
                else
                    $update;
            }
            state->history[j] = readings[j];
        }
        for (int j = 0; j < HISTORY * OBSERVED; j++)
            values[0][j] = clip(((float)state->history[j] - mean[j]) * scale[j], $most);
$layers
        for (int i = 0; i < N; i++)
            state->command[i] = (float)$output;
    }
    state->phase = (state->phase + 1) % REPEAT;
    for (int i = 0; i < N; i++)
        command[i] = $command;
"""

LAYER = """        for (int i = 0; i < $outputs; i++) {
            const double sum = $sum;
            values[$target][i] = $function;
        }"""

MAIN = """/* Compare the torques of recorded readings with those of Python; exit status 0 if they are equal.
   With the argument time: print the durations of 10^6 steps. */
#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#include "$p.h"

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

int main(int count, char **arguments)
{
    ${p}_state state;
    double torque[${P}_JOINTS], largest = 0.0;
    if (count > 1 && strcmp(arguments[1], "time") == 0) {
        print_durations("wall", CLOCK_MONOTONIC);
        print_durations("CPU", CLOCK_THREAD_CPUTIME_ID);
        return 0;
    }
    ${p}_reset(&state, &${p}_exported);
    for (int k = 0; k < PERIODS; k++) {
        ${p}_step(&state, readings + k * ${P}_READINGS, torque);
        for (int i = 0; i < ${P}_JOINTS; i++)
            largest = fmax(largest, fabs(torque[i] - expected[k * ${P}_JOINTS + i]) / ${p}_torque_limit[i]);
    }
    printf("%d periods, largest difference %.3g of the torque limit, state %u bytes\\n", PERIODS, largest,
           (unsigned)sizeof state);
    return largest <= 1e-6 ? 0 : 1;
}
"""

README = """# $title

C99 without memory allocation; it needs `math.h` only. All that changes is in `${p}_state`, so that several controllers
can run. Test it on your computer: `cc -std=c99 -O2 main.c $p.c -lm -o test && ./test`; `./test time` prints the longest
of 10^6 steps (POSIX).

- `${p}_reset(&state, &${p}_exported)` starts the move from $start to $goal rad, with tables in `${p}_move`. For
  another move, export again with `--start` and `--goal`, or compute the tables and pass them to `${p}_reset`.
- `${p}_step(&state, readings, torque)` is called every $period s and returns motor torques in N m, at most $limits.

Environment: $environment. Angles in rad, lengths in m, torques in N m.$note

| reading | values of `readings` | unit |
| --- | --- | --- |
$table

`angle_errors` are goal minus motor angles; `goal_rates` are zero for a fixed goal. `state` has coordinates and rates in
the order of `states` in `flexman export matlab`. `fine_NAME` is arcsinh of NAME over a scale, see the sensor `fine`.
"""

LINEAR_NOTE = """ The Kalman filter and the regulator are linear about the goal: use it near the goal."""
