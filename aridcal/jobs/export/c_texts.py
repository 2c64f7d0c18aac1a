"""The parts of the C export that are the same for every robot; ``NAME`` stands for its name."""

HEADER = """\
#ifndef NAME_H
#define NAME_H

#ifdef __cplusplus
extern "C" {
#endif

{sizes}

/* Names of the joints in q[], with their units and what was measured of them; a null pointer ends them. */
extern const char *const NAME_joint_names[];

/* Names of the columns in NAME_conditions; a null pointer ends them. */
extern const char *const NAME_condition_names[];

typedef struct {
{conditions}
} NAME_conditions;

/* The target in the world: R row by row, p in m. */
typedef struct {
    double R[9];
    double p[3];
} NAME_pose;

typedef enum {
    NAME_OK = 0,
    NAME_OUT_OF_RANGE, /* outside of what was measured: the result is written and extrapolates */
    NAME_LIMIT,        /* a joint stands at its limit, and the target is not reached */
    NAME_NOT_REACHED,  /* the nearest that was found is written */
    NAME_BAD_INPUT     /* not a number, or infinite: nothing is written */
} NAME_status;

/* Where the target is. Readings q in rad and m; `c` may be a null pointer if there are no conditions. */
NAME_status NAME_forward(const double q[], const NAME_conditions *c, NAME_pose *target);

/* The same of the arm as its URDF has it, between the frames of base and target that were identified. */
NAME_status NAME_nominal(const double q[], NAME_pose *target);

/* How the target moves with each reading, J[6 * NAME_JOINTS] row by row: linear, then angular, in world axes. */
NAME_status NAME_jacobian(const double q[], const NAME_conditions *c, double J[]);

/* Readings q that bring the real target to where the nominal arm has it at the readings `wanted`, near these, within the limits
 * of the joints. error[2], which may be a null pointer: how far it still is from there, m and rad{no_rotation}.
 * It takes at most {newton} steps of Newton's method, whatever comes. Where the arm is singular or meets a limit, q may lie far
 * from `wanted`: compare them before you send it. `q` may be `wanted`. */
NAME_status NAME_correct(const double wanted[], const NAME_conditions *c, double q[], double error[2]);

/* NAME_OK where readings and conditions are among those that were measured, else NAME_OUT_OF_RANGE. */
NAME_status NAME_in_range(const double q[], const NAME_conditions *c);

#ifdef __cplusplus
}
#endif

#endif
"""

TABLE_FUNCTIONS = {
    ("curve", 0): """
/* A cubic between each knot and the next; 0 beyond the ends. */
static double curve(double z, double start, double knot, int count, const double piece[][4])
{
    const double u = (z - start) / knot;
    if (!(u >= 0.0 && u < count))
        return 0.0;
    const double *a = piece[(int)u], v = u - (int)u;
    return a[0] + v * (a[1] + v * (a[2] + v * a[3]));
}
""",
    ("curve", 1): """
static double curve_slope(double z, double start, double knot, int count, const double piece[][4])
{
    const double u = (z - start) / knot;
    if (!(u >= 0.0 && u < count))
        return 0.0;
    const double *a = piece[(int)u], v = u - (int)u;
    return (a[1] + v * (2.0 * a[2] + v * 3.0 * a[3])) / knot;
}
""",
    ("spline", 0): """
/* Cubic B-spline, 1 at its middle, 0 beyond 2. */
static double spline(double z)
{
    const double u = fabs(z), v = u < 2.0 ? 2.0 - u : 0.0;
    return u < 1.0 ? 1.0 - u * u * (1.5 - 0.75 * u) : 0.25 * v * v * v;
}
""",
    ("spline", 1): """
static double spline_slope(double z)
{
    const double u = fabs(z), v = u < 2.0 ? 2.0 - u : 0.0;
    const double slope = u < 1.0 ? u * (2.25 * u - 3.0) : -0.75 * v * v;
    return z < 0.0 ? -slope : slope;
}
""",
    ("pairs", 0): """
/* A sum of products of two splines: middle and knot of x, of y, and the weight. */
static double pairs(double x, double y, int count, const double row[][5])
{
    double sum = 0.0;
    for (int k = 0; k < count; k++)
        sum += row[k][4] * spline((x - row[k][0]) / row[k][1]) * spline((y - row[k][2]) / row[k][3]);
    return sum;
}
""",
    ("pairs", 1): """
static double pairs_slope(int by, double x, double y, int count, const double row[][5])
{
    double sum = 0.0;
    for (int k = 0; k < count; k++) {
        const double u = (x - row[k][0]) / row[k][1], v = (y - row[k][2]) / row[k][3];
        sum += row[k][4] * (by == 1 ? spline_slope(u) * spline(v) / row[k][1] : spline(u) * spline_slope(v) / row[k][3]);
    }
    return sum;
}
""",
    ("balls", 0): """
/* A sum of functions about places: place, radius and weight. */
static double balls(double x, double y, double z, int count, const double row[][5])
{
    double sum = 0.0;
    for (int k = 0; k < count; k++) {
        const double a = x - row[k][0], b = y - row[k][1], c = z - row[k][2], square = a * a + b * b + c * c;
        if (square < row[k][3] * row[k][3]) {
            const double u = sqrt(square) / row[k][3], v = (1.0 - u) * (1.0 - u);
            sum += row[k][4] * v * v * (4.0 * u + 1.0);
        }
    }
    return sum;
}
""",
    ("balls", 1): """
static double balls_slope(int by, double x, double y, double z, int count, const double row[][5])
{
    double sum = 0.0;
    for (int k = 0; k < count; k++) {
        const double d[3] = {x - row[k][0], y - row[k][1], z - row[k][2]}, radius = row[k][3];
        const double square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        if (square < radius * radius) {
            const double v = 1.0 - sqrt(square) / radius;
            sum -= row[k][4] * 20.0 * v * v * v * d[by - 1] / (radius * radius);
        }
    }
    return sum;
}
""",
}
"""Sums that tables hold, and their slopes by one of their arguments."""

WALK = """
/* Moves a frame on: to the step's own frame, then about or along its z axis. */
static void move(NAME_pose *T, const step *s, double at)
{
    for (int i = 0; i < 3; i++) {
        double *row = T->R + 3 * i;
        const double x = row[0], y = row[1], z = row[2];
        T->p[i] += x * s->p[0] + y * s->p[1] + z * s->p[2];
        row[0] = x * s->R[0] + y * s->R[3] + z * s->R[6];
        row[1] = x * s->R[1] + y * s->R[4] + z * s->R[7];
        row[2] = x * s->R[2] + y * s->R[5] + z * s->R[8];
    }
    if (s->turns == 1) {
        const double c = cos(at), n = sin(at);
        for (int i = 0; i < 3; i++) {
            double *row = T->R + 3 * i;
            const double x = row[0], y = row[1];
            row[0] = x * c + y * n;
            row[1] = y * c - x * n;
        }
    } else if (s->turns == 0) {
        for (int i = 0; i < 3; i++)
            T->p[i] += T->R[3 * i + 2] * at;
    }
}

/* From the world to the target; frame[], if it is there, gets where each step is. */
static void walk(const step steps[], int count, const double at[], NAME_pose *T, NAME_pose frame[])
{
    *T = (NAME_pose){{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}};
    for (int k = 0; k < count; k++) {
        move(T, steps + k, at[k]);
        if (frame)
            frame[k] = *T;
    }
    move(T, steps + count, 0.0);
}

static void pose_and_jacobian(const double q[], const NAME_conditions *c, NAME_pose *T, double J[])
{
    double at[STEPS], slope[SLOPES];
    NAME_pose frame[STEPS];
    places_and_slopes(q, c, at, slope);
    walk(model_steps, STEPS, at, T, frame);
    for (int k = 0; k < 6 * NAME_JOINTS; k++)
        J[k] = 0.0;
    for (int k = 0; k < SLOPES; k++) {
        const int step_of = slope_of[k][0];
        const double *R = frame[step_of].R, *o = frame[step_of].p;
        const double x = slope[k] * R[2], y = slope[k] * R[5], z = slope[k] * R[8];
        double *column = J + slope_of[k][1];
        if (model_steps[step_of].turns) {
            const double a = T->p[0] - o[0], b = T->p[1] - o[1], d = T->p[2] - o[2];
            column[0] += y * d - z * b;
            column[NAME_JOINTS] += z * a - x * d;
            column[2 * NAME_JOINTS] += x * b - y * a;
            column[3 * NAME_JOINTS] += x;
            column[4 * NAME_JOINTS] += y;
            column[5 * NAME_JOINTS] += z;
        } else {
            column[0] += x;
            column[NAME_JOINTS] += y;
            column[2 * NAME_JOINTS] += z;
        }
    }
}

static int finite_readings(const double q[])
{
    for (int k = 0; k < NAME_JOINTS; k++)
        if (!isfinite(q[k]))
            return 0;
    return 1;
}

NAME_status NAME_forward(const double q[], const NAME_conditions *c, NAME_pose *target)
{
    double at[STEPS];
    if (!finite_readings(q) || !finite_conditions(c))
        return NAME_BAD_INPUT;
    places(q, c, at);
    walk(model_steps, STEPS, at, target, 0);
    return NAME_OK;
}

NAME_status NAME_nominal(const double q[], NAME_pose *target)
{
    double at[NOMINAL_STEPS];
    if (!finite_readings(q))
        return NAME_BAD_INPUT;
    nominal_places(q, at);
    walk(nominal_steps, NOMINAL_STEPS, at, target, 0);
    return NAME_OK;
}

NAME_status NAME_jacobian(const double q[], const NAME_conditions *c, double J[])
{
    NAME_pose T;
    if (!finite_readings(q) || !finite_conditions(c))
        return NAME_BAD_INPUT;
    pose_and_jacobian(q, c, &T, J);
    return NAME_OK;
}
"""

SOLVER = """
/* How far the target is from where it is wanted, and how the readings bring it nearer; rotations count as LEVER m a rad. */
static double look(const double q[], const NAME_conditions *c, const NAME_pose *wanted, double e[], double J[], double miss[2])
{
    NAME_pose T;
    double whole[6 * NAME_JOINTS], square = 0.0;
    pose_and_jacobian(q, c, &T, whole);
    for (int i = 0; i < 3; i++) {
        e[i] = wanted->p[i] - T.p[i];
        square += e[i] * e[i];
        for (int k = 0; k < NAME_JOINTS; k++)
            J[i * NAME_JOINTS + k] = whole[i * NAME_JOINTS + k];
    }
    miss[0] = sqrt(square);
    miss[1] = NAN;
#if ROWS == 6
    /* The rotation vector of D = wanted * T', from its skew part and its trace. */
    double D[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            D[3 * i + j] = wanted->R[3 * i] * T.R[3 * j] + wanted->R[3 * i + 1] * T.R[3 * j + 1]
                           + wanted->R[3 * i + 2] * T.R[3 * j + 2];
    const double v[3] = {(D[7] - D[5]) / 2.0, (D[2] - D[6]) / 2.0, (D[3] - D[1]) / 2.0};
    const double sine = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), cosine = (D[0] + D[4] + D[8] - 1.0) / 2.0;
    const double angle = atan2(sine, cosine), scale = sine > 1e-12 ? angle / sine : 1.0;
    for (int i = 0; i < 3; i++) {
        e[3 + i] = LEVER * scale * v[i];
        square += e[3 + i] * e[3 + i];
        for (int k = 0; k < NAME_JOINTS; k++)
            J[(3 + i) * NAME_JOINTS + k] = LEVER * whole[(3 + i) * NAME_JOINTS + k];
    }
    miss[1] = angle;
#endif
    return square;
}

/* Solves H x = b of `size` numbers by Cholesky's factors, which replace H. */
static void solve(int size, double H[6][6], double b[6])
{
    for (int i = 0; i < size; i++)
        for (int j = 0; j <= i; j++) {
            double sum = H[i][j];
            for (int k = 0; k < j; k++)
                sum -= H[i][k] * H[j][k];
            H[i][j] = i == j ? sqrt(sum > TINY ? sum : TINY) : sum / H[j][j];
        }
    for (int i = 0; i < size; i++) {
        for (int k = 0; k < i; k++)
            b[i] -= H[i][k] * b[k];
        b[i] /= H[i][i];
    }
    for (int i = size - 1; i >= 0; i--) {
        for (int k = i + 1; k < size; k++)
            b[i] -= H[k][i] * b[k];
        b[i] /= H[i][i];
    }
}

/* The shortest step of some readings with J step = e where these are enough, J' (J J' + damping)^-1 e; else least squares. */
static void shortest(const double J[], const double e[], const int some[], int count, double damping, double step_of[])
{
    double H[6][6], b[6];
    const int many = count >= ROWS, size = many ? ROWS : count;
    for (int i = 0; i < size; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = i == j ? damping : 0.0;
            for (int k = 0; k < (many ? count : ROWS); k++)
                sum += many ? J[i * NAME_JOINTS + some[k]] * J[j * NAME_JOINTS + some[k]]
                            : J[k * NAME_JOINTS + some[i]] * J[k * NAME_JOINTS + some[j]];
            H[i][j] = sum;
        }
        b[i] = many ? e[i] : 0.0;
        for (int k = 0; k < ROWS && !many; k++)
            b[i] += J[k * NAME_JOINTS + some[i]] * e[k];
    }
    solve(size, H, b);
    for (int k = 0; k < count; k++) {
        double sum = many ? 0.0 : b[k];
        for (int i = 0; i < size && many; i++)
            sum += J[i * NAME_JOINTS + some[k]] * b[i];
        step_of[some[k]] = sum;
    }
}

/* A damped step inside the limits: readings that meet one stay there while the others go on. */
static void inside(const double q[], const double J[], const double e[], double damping, double trial[])
{
    int some[NAME_JOINTS], count = 0;
    double rest[ROWS], step_of[NAME_JOINTS];
    for (int k = 0; k < NAME_JOINTS; k++) {
        trial[k] = q[k];
        if (moves[k])
            some[count++] = k;
    }
    for (int i = 0; i < ROWS; i++)
        rest[i] = e[i];
    while (count > 0) {
        double fastest = LARGEST_TURN;
        int left = 0;
        shortest(J, rest, some, count, damping, step_of);
        for (int k = 0; k < count; k++)
            if (turning[some[k]] && fabs(step_of[some[k]]) > fastest)
                fastest = fabs(step_of[some[k]]);
        for (int k = 0; k < count; k++) {
            const int j = some[k];
            const double there = q[j] + step_of[j] * (LARGEST_TURN / fastest);
            trial[j] = there < limit[j][0] ? limit[j][0] : there > limit[j][1] ? limit[j][1] : there;
            if (trial[j] == there)
                some[left++] = j;
            else
                for (int i = 0; i < ROWS; i++)
                    rest[i] -= J[i * NAME_JOINTS + j] * (trial[j] - q[j]);
        }
        if (left == count)
            return;
        count = left;
    }
}

/* Newton's method from readings `at`, which become the best that were found; miss[] is what is then missed. */
static double search(const NAME_conditions *c, const NAME_pose *goal, double at[], double miss[2])
{
    double e[ROWS], J[ROWS * NAME_JOINTS], damping = 0.0;
    double square = look(at, c, goal, e, J, miss);
    for (int n = 0; n < NEWTON_STEPS && !(square < EXACT * EXACT); n++) {
        double trial[NAME_JOINTS], e_trial[ROWS], J_trial[ROWS * NAME_JOINTS], miss_trial[2];
        inside(at, J, e, damping + TINY, trial);
        const double square_trial = look(trial, c, goal, e_trial, J_trial, miss_trial);
        if (square_trial < square) {
            square = square_trial;
            damping = damping <= FIRST_DAMPING ? 0.0 : damping / FALL;
            memcpy(at, trial, sizeof trial);
            memcpy(e, e_trial, sizeof e);
            memcpy(J, J_trial, sizeof J);
            memcpy(miss, miss_trial, sizeof miss_trial);
        } else {
            damping = damping > 0.0 ? damping * RISE : FIRST_DAMPING;
        }
    }
    return square;
}

NAME_status NAME_correct(const double wanted[], const NAME_conditions *c, double q[], double error[2])
{
    NAME_pose goal;
    double start[NAME_JOINTS], best[NAME_JOINTS], miss[2], square = INFINITY;
    if (!finite_readings(wanted) || !finite_conditions(c))
        return NAME_BAD_INPUT;
    NAME_nominal(wanted, &goal);
    for (int k = 0; k < NAME_JOINTS; k++)
        start[k] = wanted[k] < limit[k][0] ? limit[k][0] : wanted[k] > limit[k][1] ? limit[k][1] : wanted[k];
    memcpy(best, start, sizeof best);
    for (int n = 0; n < STARTS && !(square < NEAR * NEAR); n++) {
        double at[NAME_JOINTS], miss_there[2];
        for (int k = 0; k < NAME_JOINTS; k++) {
            const double there = start[k] + (moves[k] ? kick[n][k] : 0.0);
            at[k] = there < limit[k][0] ? limit[k][0] : there > limit[k][1] ? limit[k][1] : there;
        }
        const double square_there = search(c, &goal, at, miss_there);
        if (square_there < square) {
            square = square_there;
            memcpy(best, at, sizeof best);
            memcpy(miss, miss_there, sizeof miss);
        }
    }
    memcpy(q, best, sizeof best);
    if (error)
        memcpy(error, miss, sizeof miss);
    if (miss[0] < REACHED_M && (ROWS == 3 || miss[1] < REACHED_RAD))
        return NAME_in_range(best, c);
    for (int k = 0; k < NAME_JOINTS; k++)
        if (moves[k] && (best[k] <= limit[k][0] || best[k] >= limit[k][1]))
            return NAME_LIMIT;
    return NAME_NOT_REACHED;
}
"""

TEST = """\
/* {count} rows of `aridcal predict`, written by `aridcal export`: exit status 0 if NAME_forward agrees with all of them. */

#include "NAME.h"

#include <math.h>
#include <stdio.h>

#define ROWS {count}
#define TOLERANCE 1e-12 /* m, and elements of R: some hundred roundings, of this machine's sin and cos among them */

/* Readings, conditions, R row by row, p. */
static const double rows[ROWS][{width}] = {
{rows}
};

int main(void)
{
    double worst_R = 0.0, worst_p = 0.0;
    for (int n = 0; n < ROWS; n++) {
        const double *row = rows[n], *expected = row + {inputs};
        const NAME_conditions c = {{values}};
        NAME_pose T;
        if (NAME_forward(row, &c, &T) != NAME_OK) {
            printf("row %d: refused\\n", n);
            return 1;
        }
        for (int k = 0; k < 9; k++)
            worst_R = fmax(worst_R, fabs(T.R[k] - expected[k]));
        for (int k = 0; k < 3; k++)
            worst_p = fmax(worst_p, fabs(T.p[k] - expected[9 + k]));
    }
    printf("NAME: %d rows, at most %.1e m and %.1e in R off\\n", ROWS, worst_p, worst_R);
    return worst_p <= TOLERANCE && worst_R <= TOLERANCE ? 0 : 1;
}
"""

CMAKE = """\
# written by `aridcal export`
cmake_minimum_required(VERSION 3.10)
project(NAME C)
set(CMAKE_C_STANDARD 99)
set(CMAKE_C_STANDARD_REQUIRED ON)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()

add_library(NAME NAME.c)
target_include_directories(NAME PUBLIC ${CMAKE_CURRENT_SOURCE_DIR})
if(UNIX)
  target_link_libraries(NAME PUBLIC m)
endif()

enable_testing()
add_executable(NAME_test NAME_test.c)
target_link_libraries(NAME_test NAME)
add_test(KEYWORD NAME_test COMMAND NAME_test)
"""
