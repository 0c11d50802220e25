/* Stiff test problems by CVODE (BDF, exact Jacobians, dense or of a band): the reference of benchmarks/stiff.py.

   Written for this benchmark after the equations in Hairer and Wanner, Solving Ordinary Differential Equations II, IV.1 and
   IV.10, and in the Bari Test Set for IVP Solvers.

       stiff PROBLEM RTOL ATOL RUNS      ->   least CPU seconds of a run, steps, the states at the end */
#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#include <cvode/cvode.h>
#include <math.h>
#include <nvector/nvector_serial.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sunlinsol/sunlinsol_band.h>
#include <sunlinsol/sunlinsol_dense.h>
#include <sunmatrix/sunmatrix_band.h>
#include <sunmatrix/sunmatrix_dense.h>
#include <time.h>

typedef void (*Rates)(double t, const double *x, double *f);
typedef void (*Slopes)(double t, const double *x, double *j); /* dense: by columns */
typedef struct {
    const char *name;
    int n;
    double stop;
    Rates rates;
    Slopes slopes;
    double start[20];
} Problem;

#define J(i, k) j[(k) * N + (i)]

#define N 3
static void robertson(double t, const double *x, double *f)
{
    (void)t;
    f[0] = -0.04 * x[0] + 1e4 * x[1] * x[2];
    f[2] = 3e7 * x[1] * x[1];
    f[1] = -f[0] - f[2];
}
static void robertson_slopes(double t, const double *x, double *j)
{
    (void)t;
    J(0, 0) = -0.04, J(0, 1) = 1e4 * x[2], J(0, 2) = 1e4 * x[1];
    J(2, 0) = 0.0, J(2, 1) = 6e7 * x[1], J(2, 2) = 0.0;
    for (int k = 0; k < 3; k++) J(1, k) = -J(0, k) - J(2, k);
}
#undef N

#define N 8
static void hires(double t, const double *x, double *f)
{
    (void)t;
    double r = 280.0 * x[5] * x[7];
    f[0] = -1.71 * x[0] + 0.43 * x[1] + 8.32 * x[2] + 0.0007;
    f[1] = 1.71 * x[0] - 8.75 * x[1];
    f[2] = -10.03 * x[2] + 0.43 * x[3] + 0.035 * x[4];
    f[3] = 8.32 * x[1] + 1.71 * x[2] - 1.12 * x[3];
    f[4] = -1.745 * x[4] + 0.43 * x[5] + 0.43 * x[6];
    f[5] = -r + 0.69 * x[3] + 1.71 * x[4] - 0.43 * x[5] + 0.69 * x[6];
    f[6] = r - 1.81 * x[6];
    f[7] = -r + 1.81 * x[6];
}
static void hires_slopes(double t, const double *x, double *j)
{
    (void)t;
    memset(j, 0, N * N * sizeof(double));
    J(0, 0) = -1.71, J(0, 1) = 0.43, J(0, 2) = 8.32, J(1, 0) = 1.71, J(1, 1) = -8.75;
    J(2, 2) = -10.03, J(2, 3) = 0.43, J(2, 4) = 0.035, J(3, 1) = 8.32, J(3, 2) = 1.71, J(3, 3) = -1.12;
    J(4, 4) = -1.745, J(4, 5) = 0.43, J(4, 6) = 0.43;
    double a = 280.0 * x[7], b = 280.0 * x[5];
    J(5, 3) = 0.69, J(5, 4) = 1.71, J(5, 5) = -a - 0.43, J(5, 6) = 0.69, J(5, 7) = -b;
    J(6, 5) = a, J(6, 6) = -1.81, J(6, 7) = b, J(7, 5) = -a, J(7, 6) = 1.81, J(7, 7) = -b;
}
#undef N

#define N 20
/* The reactions: constant, reactants (-1: none), and what they make of which species. */
static const double K[] = {0.35, 26.6, 12300, 0.00086, 0.00082, 15000, 0.00013, 24000, 16500, 9000, 0.022, 12000, 1.88,
                           16300, 4.8e6, 0.00035, 0.0175, 1e8, 4.44e11, 1240, 2.1, 5.78, 0.0474, 1780, 3.12};
static const int ONE[] = {0, 1, 4, 6, 6, 6, 8, 8, 10, 10, 12, 9, 13, 0, 2, 3, 3, 15, 15, 16, 18, 18, 0, 18, 19};
static const int TWO[] = {-1, 3, 1, -1, -1, 5, -1, 5, 1, 0, -1, 1, -1, 5, -1, -1, -1, -1, -1, 5, -1, -1, 3, 0, -1};
static void made(const double *r, double *f)
{
    f[0] = -r[0] - r[9] - r[13] - r[22] - r[23] + r[1] + r[2] + r[8] + r[10] + r[11] + r[21] + r[24];
    f[1] = -r[1] - r[2] - r[8] - r[11] + r[0] + r[20];
    f[2] = -r[14] + r[0] + r[16] + r[18] + r[21];
    f[3] = -r[1] - r[15] - r[16] - r[22] + r[14];
    f[4] = -r[2] + 2 * r[3] + r[5] + r[6] + r[12] + r[19];
    f[5] = -r[5] - r[7] - r[13] - r[19] + r[2] + 2 * r[17];
    f[6] = -r[3] - r[4] - r[5] + r[12];
    f[7] = r[3] + r[4] + r[5] + r[6];
    f[8] = -r[6] - r[7];
    f[9] = -r[11] + r[6] + r[8];
    f[10] = -r[8] - r[9] + r[7] + r[10];
    f[11] = r[8];
    f[12] = -r[10] + r[9];
    f[13] = -r[12] + r[11];
    f[14] = r[13];
    f[15] = -r[17] - r[18] + r[15];
    f[16] = -r[19];
    f[17] = r[19];
    f[18] = -r[20] - r[21] - r[23] + r[22] + r[24];
    f[19] = -r[24] + r[23];
}
static void pollution(double t, const double *x, double *f)
{
    double r[25];
    (void)t;
    for (int i = 0; i < 25; i++) r[i] = K[i] * x[ONE[i]] * (TWO[i] < 0 ? 1.0 : x[TWO[i]]);
    made(r, f);
}
static void pollution_slopes(double t, const double *x, double *j)
{
    (void)t;
    for (int k = 0; k < N; k++) {
        double r[25];
        for (int i = 0; i < 25; i++) {
            r[i] = ONE[i] == k ? K[i] * (TWO[i] < 0 ? 1.0 : x[TWO[i]]) : 0.0;
            if (TWO[i] == k) r[i] += K[i] * x[ONE[i]];
        }
        made(r, j + k * N);
    }
}
#undef N

#define N 2
static double mu;
static void van_der_pol(double t, const double *x, double *f)
{
    (void)t;
    f[0] = x[1];
    f[1] = mu * (1.0 - x[0] * x[0]) * x[1] - x[0];
}
static void van_der_pol_slopes(double t, const double *x, double *j)
{
    (void)t;
    J(0, 0) = 0.0, J(0, 1) = 1.0, J(1, 0) = -2.0 * mu * x[0] * x[1] - 1.0, J(1, 1) = mu * (1.0 - x[0] * x[0]);
}
#undef N

#define N 4
static void e5(double t, const double *x, double *f)
{
    (void)t;
    double a = 7.89e-10 * x[0], b = 1.1e7 * x[0] * x[2], c = 1.13e9 * x[1] * x[2], d = 1.13e3 * x[3];
    f[0] = -a - b, f[1] = a - c, f[3] = b - d, f[2] = f[1] - f[3];
}
static void e5_slopes(double t, const double *x, double *j)
{
    (void)t;
    J(0, 0) = -7.89e-10 - 1.1e7 * x[2], J(0, 1) = 0.0, J(0, 2) = -1.1e7 * x[0], J(0, 3) = 0.0;
    J(1, 0) = 7.89e-10, J(1, 1) = -1.13e9 * x[2], J(1, 2) = -1.13e9 * x[1], J(1, 3) = 0.0;
    J(3, 0) = 1.1e7 * x[2], J(3, 1) = 0.0, J(3, 2) = 1.1e7 * x[0], J(3, 3) = -1.13e3;
    for (int k = 0; k < 4; k++) J(2, k) = J(1, k) - J(3, k);
}
#undef N

#define N 15
static const double PI = 3.14159265358979323846;
enum { WIRES = 4 };
static void voltages(double t, const double *x, double *u)
{
    double two = 2.0 * sin(20000.0 * PI * t);
    u[0] = x[2] - x[4] - x[6] - two, u[1] = -x[3] + x[5] - x[6] - two;
    u[2] = x[3] + x[4] + x[6] + two, u[3] = -x[2] - x[5] + x[6] + two;
}
static void ring(double t, const double *x, double *f)
{
    double u[WIRES], q[WIRES];
    voltages(t, x, u);
    for (int i = 0; i < WIRES; i++) q[i] = 40.67286402e-9 * (exp(17.7493332 * u[i]) - 1.0);
    f[0] = (x[7] - 0.5 * x[9] + 0.5 * x[10] + x[13] - x[0] / 25000.0) / 1.6e-8;
    f[1] = (x[8] - 0.5 * x[11] + 0.5 * x[12] + x[14] - x[1] / 25000.0) / 1.6e-8;
    f[2] = (x[9] - q[0] + q[3]) / 2e-12;
    f[3] = (-x[10] + q[1] - q[2]) / 2e-12;
    f[4] = (x[11] + q[0] - q[2]) / 2e-12;
    f[5] = (-x[12] - q[1] + q[3]) / 2e-12;
    f[6] = (-x[6] / 50.0 + q[0] + q[1] - q[2] - q[3]) / 1e-8;
    f[7] = -x[0] / 4.45;
    f[8] = -x[1] / 4.45;
    f[9] = (0.5 * x[0] - x[2] - 17.3 * x[9]) / 5e-4;
    f[10] = (-0.5 * x[0] + x[3] - 17.3 * x[10]) / 5e-4;
    f[11] = (0.5 * x[1] - x[4] - 17.3 * x[11]) / 5e-4;
    f[12] = (-0.5 * x[1] + x[5] - 17.3 * x[12]) / 5e-4;
    f[13] = (-x[0] + 0.5 * sin(2000.0 * PI * t) - 86.3 * x[13]) / 0.002;
    f[14] = (-x[1] - 636.3 * x[14]) / 0.002;
}
static void ring_slopes(double t, const double *x, double *j)
{
    static const int at[WIRES][3] = {{2, 4, 6}, {3, 5, 6}, {3, 4, 6}, {2, 5, 6}};
    static const int sign[WIRES][3] = {{1, -1, -1}, {-1, 1, -1}, {1, 1, 1}, {-1, -1, 1}};
    static const int row[WIRES][3] = {{2, 4, 6}, {3, 5, 6}, {3, 4, 6}, {2, 5, 6}};
    static const int gives[WIRES][3] = {{-1, 1, 1}, {1, -1, 1}, {-1, -1, -1}, {1, 1, -1}};
    double u[WIRES];
    voltages(t, x, u);
    memset(j, 0, N * N * sizeof(double));
    J(6, 6) = -1.0 / 50.0 / 1e-8;
    for (int i = 0; i < WIRES; i++) {
        double slope = 40.67286402e-9 * 17.7493332 * exp(17.7493332 * u[i]);
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++)
                J(row[i][a], at[i][b]) += gives[i][a] * sign[i][b] * slope / (row[i][a] == 6 ? 1e-8 : 2e-12);
    }
    J(0, 7) = J(0, 13) = J(1, 8) = J(1, 14) = 1.0 / 1.6e-8;
    J(0, 9) = J(1, 11) = -0.5 / 1.6e-8, J(0, 10) = J(1, 12) = 0.5 / 1.6e-8;
    J(0, 0) = J(1, 1) = -1.0 / 25000.0 / 1.6e-8;
    J(2, 9) = J(4, 11) = 1.0 / 2e-12, J(3, 10) = J(5, 12) = -1.0 / 2e-12;
    J(7, 0) = J(8, 1) = -1.0 / 4.45;
    for (int k = 9; k < 13; k++) {
        double side = k % 2 ? 1.0 : -1.0;
        J(k, k > 10) = side * 0.5 / 5e-4, J(k, k - 7) = -side / 5e-4, J(k, k) = -17.3 / 5e-4;
    }
    J(13, 0) = J(14, 1) = -1.0 / 0.002, J(13, 13) = -86.3 / 0.002, J(14, 14) = -636.3 / 0.002;
}
#undef N

/* A drive: an amplifier of 1e-6 s, current, speed, position, and a position controller with an integral. */
#define N 5
static void drive(double t, const double *x, double *f)
{
    double e = sin(5.0 * t) - x[3];
    f[0] = (40.0 * e + 30.0 * x[4] - 1.5 * x[2] - x[0]) / 1e-6;
    f[1] = (x[0] - 0.8 * x[1] - 0.05 * x[2]) / 2e-3;
    f[2] = (0.05 * x[1] - 1e-4 * x[2] - 2e-3 * tanh(x[2] / 0.1)) / 1e-4;
    f[3] = x[2];
    f[4] = e;
}
static void drive_slopes(double t, const double *x, double *j)
{
    (void)t;
    double y = tanh(x[2] / 0.1);
    memset(j, 0, N * N * sizeof(double));
    J(0, 0) = -1e6, J(0, 2) = -1.5e6, J(0, 3) = -40e6, J(0, 4) = 30e6;
    J(1, 0) = 1.0 / 2e-3, J(1, 1) = -0.8 / 2e-3, J(1, 2) = -0.05 / 2e-3;
    J(2, 1) = 0.05 / 1e-4, J(2, 2) = (-1e-4 - 2e-2 * (1.0 - y * y)) / 1e-4;
    J(3, 2) = 1.0, J(4, 3) = -1.0;
}
#undef N

/* A rod of n slices, which conducts and radiates: tridiagonal. Its time is that of 1,000 slices at c = 1e5. */
static int slices;
static double conduction;
static void rod(double t, const double *x, double *f)
{
    (void)t;
    for (int k = 0; k < slices; k++) {
        double left = k ? x[k - 1] : 1.0, right = k + 1 < slices ? x[k + 1] : 0.0, square = x[k] * x[k];
        f[k] = conduction * (left - 2.0 * x[k] + right) - square * square;
    }
}

static const Problem problems[] = {
    {"robertson", 3, 1e11, robertson, robertson_slopes, {1.0}},
    {"hires", 8, 321.8122, hires, hires_slopes, {1.0, 0, 0, 0, 0, 0, 0, 0.0057}},
    {"pollution", 20, 60.0, pollution, pollution_slopes,
     {0, 0.2, 0, 0.04, 0, 0, 0.1, 0.3, 0.01, 0, 0, 0, 0, 0, 0, 0, 0.007}},
    {"van der Pol 1e3", 2, 2000.0, van_der_pol, van_der_pol_slopes, {2.0}},
    {"van der Pol 1e6", 2, 2e6, van_der_pol, van_der_pol_slopes, {2.0}},
    {"e5", 4, 1e13, e5, e5_slopes, {1.76e-3}},
    {"ring modulator", 15, 1e-3, ring, ring_slopes, {0}},
    {"drive", 5, 2.0, drive, drive_slopes, {0}},
    {"rod 200", 200, 1.0, rod, NULL, {0}},
    {"rod 1000", 1000, 1.0, rod, NULL, {0}},
};

static int rates(sunrealtype t, N_Vector x, N_Vector f, void *problem)
{
    ((const Problem *)problem)->rates(t, NV_DATA_S(x), NV_DATA_S(f));
    return 0;
}

static int slopes(sunrealtype t, N_Vector x, N_Vector f, SUNMatrix made, void *problem, N_Vector a, N_Vector b, N_Vector c)
{
    (void)f, (void)a, (void)b, (void)c;
    const Problem *p = problem;
    if (p->slopes) {
        p->slopes(t, NV_DATA_S(x), SM_DATA_D(made));
        return 0;
    }
    for (int k = 0; k < p->n; k++) {
        double y = NV_Ith_S(x, k), *column = SM_COLUMN_B(made, k);
        if (k) SM_COLUMN_ELEMENT_B(column, k - 1, k) = conduction;
        SM_COLUMN_ELEMENT_B(column, k, k) = -2.0 * conduction - 4.0 * y * y * y;
        if (k + 1 < p->n) SM_COLUMN_ELEMENT_B(column, k + 1, k) = conduction;
    }
    return 0;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int count, char **words)
{
    if (count != 5) return 2;
    const Problem *p = NULL;
    for (size_t i = 0; i < sizeof problems / sizeof *problems; i++)
        if (!strcmp(words[1], problems[i].name)) p = &problems[i];
    if (!p) return 2;
    mu = strstr(words[1], "1e6") ? 1e6 : 1e3;
    slices = p->n, conduction = 1e5 * (p->n / 1000.0) * (p->n / 1000.0);
    const double rtol = atof(words[2]), atol = atof(words[3]);
    double least = INFINITY;
    long steps = 0;
    N_Vector x = NULL;
    for (int run = 0; run < atoi(words[4]); run++) {
        double begun = seconds(), t;
        SUNContext context;
        SUNContext_Create(NULL, &context);
        x = N_VNew_Serial(p->n, context);
        for (int i = 0; i < p->n; i++) NV_Ith_S(x, i) = i < 20 ? p->start[i] : 0.0;
        void *solver = CVodeCreate(CV_BDF, context);
        CVodeInit(solver, rates, 0.0, x);
        CVodeSStolerances(solver, rtol, atol);
        CVodeSetUserData(solver, (void *)(size_t)p);
        CVodeSetMaxNumSteps(solver, 10000000);
        SUNMatrix matrix = p->slopes ? SUNDenseMatrix(p->n, p->n, context) : SUNBandMatrix(p->n, 1, 1, context);
        SUNLinearSolver linear = p->slopes ? SUNLinSol_Dense(x, matrix, context) : SUNLinSol_Band(x, matrix, context);
        CVodeSetLinearSolver(solver, linear, matrix);
        CVodeSetJacFn(solver, slopes);
        CVodeSetStopTime(solver, p->stop);
        if (CVode(solver, p->stop, x, &t, CV_NORMAL) < 0) return 1;
        CVodeGetNumSteps(solver, &steps);
        double spent = seconds() - begun;
        if (spent < least) least = spent;
        CVodeFree(&solver);
        SUNLinSolFree(linear);
        SUNMatDestroy(matrix);
    }
    printf("%.9g %ld", least, steps);
    for (int i = 0; i < p->n; i++) printf(" %.17g", NV_Ith_S(x, i));
    printf("\n");
    return 0;
}
