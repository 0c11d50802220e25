/* How the functions of the standard go to another process. calls2.h and calls3.h are lists of them, CALLS(C), of
   entries C(name, arguments): the name without its prefix, and the arguments behind the instance in their order. From
   these lists come the functions of proxy2.c and proxy3.c, the calls of host2.c and host3.c, and the shims of trace2.c
   and trace3.c. k is the place of an argument in the frame of the call:

       NUMBER(k, type, name)           a whole number, a truth value or an enumeration: n[k]
       REAL(k, name)                   x[k]
       IN(k, type, name, count)        an array that the FMU reads: span k
       OUT(k, type, name, count)       an array that it writes: span k
       TEXTS_IN(k, what, name, count)  strings that it reads: span k; what: one of them, for messages
       TEXTS_OUT(k, what, name, count) strings that it gives: span k; what: all of them, for messages
                                       (how many strings: also in n[TEXTS], where no number of a call has its place)
       STATE(k, name)                  a state of the FMU, which is a number on the importer's side: n[k]
       STATE_INOUT(k, name)            a pointer to one: span k
       NONE                            there are no arguments

   OTHERS(C) is a list of those that both sides have by hand. FMI(name) gives a name its prefix. */
#ifndef BLOCKS_CALLS_H
#define BLOCKS_CALLS_H

#ifndef BLOCKS_TRACE_H /* which gives the numbers of functions by itself: it needs no other process */
#include "channel.h"

enum { TEXTS = NUMBERS - 1 };
#endif

#define CALL_NUMBER(name, ...) CALL_##name,
enum { CALLS_BEFORE = FIRST_FUNCTION - 1, OTHERS(CALL_NUMBER) CALLS(CALL_NUMBER) CALLS_END };

/* The arguments of an entry as parameters of a function, behind the instance. */
#define PARAMETER_NUMBER(k, type, name) , type name
#define PARAMETER_REAL(k, name) , double name
#define PARAMETER_IN(k, type, name, count) , const type name[]
#define PARAMETER_OUT(k, type, name, count) , type name[]
#define PARAMETER_TEXTS_IN(k, what, name, count) , const char *const name[]
#define PARAMETER_TEXTS_OUT(k, what, name, count) , const char *name[]
#define PARAMETER_STATE(k, name) , void *name
#define PARAMETER_STATE_INOUT(k, name) , void **name
#define PARAMETER_NONE

#define TEXT_OF(token) #token
#define TEXT(token) TEXT_OF(token)
#define FULL_NAME(name) TEXT(FMI(name))

/* EACH(DO_, NUMBER(...), IN(...)) is DO_NUMBER(...) DO_IN(...), of at most eight arguments. */
#define EACH(m, ...) EACH_OF(__VA_ARGS__, 8, 7, 6, 5, 4, 3, 2, 1, 0)(m, __VA_ARGS__)
#define EACH_OF(a, b, c, d, e, f, g, h, n, ...) EACH_##n
#define EACH_1(m, a) m##a
#define EACH_2(m, a, ...) m##a EACH_1(m, __VA_ARGS__)
#define EACH_3(m, a, ...) m##a EACH_2(m, __VA_ARGS__)
#define EACH_4(m, a, ...) m##a EACH_3(m, __VA_ARGS__)
#define EACH_5(m, a, ...) m##a EACH_4(m, __VA_ARGS__)
#define EACH_6(m, a, ...) m##a EACH_5(m, __VA_ARGS__)
#define EACH_7(m, a, ...) m##a EACH_6(m, __VA_ARGS__)
#define EACH_8(m, a, ...) m##a EACH_7(m, __VA_ARGS__)

#endif
