/* Communication steps of FMI 3.0 with inputs that are set in intermediate updates: polynomials of third order, others, and
   none. Prints what is not as the standard says. The compiler's command line says which model it is: TOKEN, and INPUT, the
   value reference of a real input. */
#include "fmi3.h"

#include <math.h>
#include <stdio.h>

static struct {
    fmi3Instance instance;
    double begin, end, finished; /* of the communication step; the last time that was told as finished */
    int kind;
} at;

static double signal(double t)
{
    if (at.kind == 0)
        return 0.3 + t * (2 - t * (5 - 4 * t));
    if (at.kind == 1)
        return sin(30 * t);
    return t > 0.37 ? 1 : 0;
}

static void told(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment, (void)category;
    if (status >= fmi3Error)
        printf("%s\n", message);
}

static void inside(fmi3InstanceEnvironment environment, fmi3Float64 t, fmi3Boolean set_requested,
                   fmi3Boolean get_allowed, fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *asked,
                   fmi3Float64 *until)
{
    const fmi3ValueReference input = INPUT;
    const double u = signal(t);
    (void)environment, (void)until;
    if (t < at.begin || t > at.end || t < at.finished)
        printf("an update at %.17g s\n", t);
    if (finished)
        at.finished = t;
    if (get_allowed != finished || (can_return && !finished))
        printf("flags at %.17g s\n", t);
    *asked = fmi3False;
    if (set_requested && at.kind < 3 && fmi3SetFloat64(at.instance, &input, 1, &u, 1) != fmi3OK)
        printf("an input cannot be set at %.17g s\n", t);
}

int main(void)
{
    for (at.kind = 0; at.kind < 4; at.kind++) {
        fmi3Boolean event, end, early;
        fmi3Float64 last = 0;
        fmi3FMUState state = NULL;
        at.begin = at.end = at.finished = 0;
        at.instance = fmi3InstantiateCoSimulation("asked", TOKEN, NULL, fmi3False, fmi3False, fmi3False, fmi3True, NULL, 0,
                                                  NULL, told, inside);
        if (!at.instance || fmi3EnterInitializationMode(at.instance, fmi3False, 0, 0, fmi3False, 0) != fmi3OK ||
            fmi3ExitInitializationMode(at.instance) != fmi3OK)
            return 1;
        for (int k = 0; k < 16; k++) {
            at.begin = k * 0.0625;
            at.end = (k + 1) * 0.0625;
            for (int twice = 0; twice < 2; twice++) {
                at.finished = at.begin;
                if (twice ? fmi3SetFMUState(at.instance, state) : fmi3GetFMUState(at.instance, &state))
                    return 2;
                if (fmi3DoStep(at.instance, at.begin, 0.0625, fmi3False, &event, &end, &early, &last) != fmi3OK ||
                    last != at.end)
                    printf("a step to %.17g s\n", last);
            }
        }
        fmi3FreeFMUState(at.instance, &state);
        fmi3FreeInstance(at.instance);
    }
    return 0;
}
