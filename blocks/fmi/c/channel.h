/* What an importer and the process of its FMU have in common: a piece of memory, and whose turn it is.

   The memory is a file without a name, which both have mapped: a head, then frames. A frame is one call with its
   arrays, or one callback. Frames are a stack: inside of a callback, the importer may make calls. At any time one side
   works and the other waits; `turn` says which, and is what they sleep on. The file only grows. Places in it are
   offsets. */
#ifndef BLOCKS_CHANNEL_H
#define BLOCKS_CHANNEL_H

#include <limits.h>
#include <linux/futex.h>
#include <sched.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

_Static_assert(sizeof(void *) == 8 && sizeof(long) == 8, "the futex call takes times of 64 bits");

enum {
    NUMBERS = 6,
    REALS = 4,
    SPANS = 6,
    CHANNEL = 3,            /* the descriptor of the file in the process of the FMU */
    FIRST_BYTES = 64 * 1024, /* of the file, at the beginning */
    ASLEEP = 1
};

/* Odd: the FMU's side works. */
enum { CALL = 1, ANSWER = 2, RETURN = 3, CALLBACK = 4 };

/* Of a frame's `function`, besides the functions of the standard, whose numbers are above. */
enum { LOAD = 0, LOG = 1, UPDATE = 2, FIRST_FUNCTION = 8 };

/* As in the standard, 2.0 and 3.0. */
enum { STATUS_OK = 0, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR, STATUS_FATAL };

/* A piece of the file; at = 0: a null pointer. */
typedef struct {
    uint64_t at, bytes;
} Span;

typedef struct {
    uint64_t bytes; /* of the frame with its arrays */
    int32_t function, status;
    uint64_t n[NUMBERS];
    double x[REALS];
    Span a[SPANS];
} Frame;

typedef struct {
    _Alignas(64) _Atomic uint32_t turn;
    _Alignas(64) _Atomic uint32_t importer_sleeps, host_sleeps;
    _Atomic uint32_t taken; /* how many calls the FMU's side has begun to work on */
    _Alignas(64) uint64_t bytes; /* of the file */
    uint64_t frame;              /* of the present call */
} Head;

static inline size_t channel_aligned(size_t bytes)
{
    return (bytes + 15) & ~(size_t)15;
}

static inline uint64_t channel_now(void) /* ns */
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

/* How long a side waits awake before it sleeps. To fall asleep and to be woken takes longer than a short call; but one
   that waits awake in vain keeps others from a processor: an importer that calls many FMUs in turn would find the
   processors taken by those that were called before. So who waited in vain sleeps at once for the next 1, 3, 7 ...
   times before it tries again. */
typedef struct {
    uint64_t most; /* ns */
    unsigned failures, rest;
} Patience;

enum { MOST_FAILURES = 7 };

static inline Patience channel_patience(void)
{
    cpu_set_t mine;
    /* With one processor the other side works only when this one sleeps. */
    const int is_one = sched_getaffinity(0, sizeof mine, &mine) == 0 && CPU_COUNT(&mine) < 2;
    return (Patience){is_one ? 0 : 20000, 0, 0};
}

static inline void channel_pause(void)
{
#if defined __x86_64__
    __builtin_ia32_pause();
#elif defined __aarch64__
    __asm__ volatile("yield");
#endif
}

/* Gives the turn to the other side, whose flag is `sleeps`. */
static inline void channel_give(Head *head, uint32_t turn, _Atomic uint32_t *sleeps)
{
    atomic_store(&head->turn, turn);
    if (atomic_load(sleeps))
        syscall(SYS_futex, &head->turn, FUTEX_WAKE, INT_MAX, NULL, NULL, 0);
}

static inline int channel_is_given(Head *head, uint32_t mine)
{
    return atomic_load_explicit(&head->turn, memory_order_acquire) % 2 == mine;
}

/* Waits awake, as far as it is worth it, until turn % 2 is `mine`. Returns whether it is. */
static inline int channel_spin(Head *head, uint32_t mine, Patience *patience)
{
    if (!patience->most || patience->rest) {
        patience->rest -= patience->rest > 0;
        return channel_is_given(head, mine);
    }
    const uint64_t begun = channel_now();
    do {
        for (int k = 0; k < 50; k++) {
            if (channel_is_given(head, mine)) {
                patience->failures = 0;
                return 1;
            }
            channel_pause();
        }
    } while (channel_now() - begun < patience->most);
    patience->failures += patience->failures < MOST_FAILURES;
    patience->rest = (1u << patience->failures) - 1;
    return 0;
}

/* Sleeps for at most `ns` (0: without end), or until turn % 2 is `mine`. Returns whether it is. */
static inline int channel_sleep(Head *head, uint32_t mine, _Atomic uint32_t *sleeps, uint64_t ns)
{
    const struct timespec most = {(time_t)(ns / 1000000000u), (long)(ns % 1000000000u)};
    /* In this order, or a turn that is given in between wakes nobody. */
    atomic_store(sleeps, ASLEEP);
    const uint32_t seen = atomic_load(&head->turn);
    if (seen % 2 != mine)
        syscall(SYS_futex, &head->turn, FUTEX_WAIT, seen, ns ? &most : NULL, NULL, 0);
    atomic_store(sleeps, 0);
    return atomic_load(&head->turn) % 2 == mine;
}

#endif
