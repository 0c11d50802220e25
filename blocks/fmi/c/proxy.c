/* See proxy.h. What comes back from the other side is checked before it is used: an FMU that writes where it must not
   may write here as well. That keeps accidents away from the importer; it is no sandbox against malice. */
#define _GNU_SOURCE
#include "proxy.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>

extern char **environ;

enum { SETTINGS = 32768, LIBRARIES = 64 };
static const uint64_t MS = 1000000;
static const uint64_t LONGEST_SLEEP = 20 * 1000000; /* ns; after it, it is seen whether the process is still there */

/* Filled in, in the copy of this library that belongs to an FMU: texts with their zeros, an empty one at the end - the
   host, the timeout of calls and that of loading in ns (0: none), the libraries to load in their order. Not static, so
   that the compiler does not take it for what stands here. */
char blocks_proxy_settings[SETTINGS] = "BLOCKS-PROXY-SETTINGS:1";

/* How the last start in this thread failed. */
static _Thread_local char last_failure[512];

__attribute__((visibility("default"))) const char *blocks_proxy_why(const void *instance);
__attribute__((visibility("default"))) int blocks_proxy_process(const void *instance);

/* How the process of an instance ended, "" where it did not; null: why this thread's last instance was not made. */
const char *blocks_proxy_why(const void *instance)
{
    return instance ? ((const Proxy *)instance)->why : last_failure;
}

/* The number of the process; 0: there is none any more. */
int blocks_proxy_process(const void *instance)
{
    return (int)((const Proxy *)instance)->process;
}

/* --- how a process ends ---- */

static const char *signal_name(int number)
{
    switch (number) {
    case SIGSEGV: return "segmentation fault";
    case SIGABRT: return "abort";
    case SIGBUS: return "bus error";
    case SIGFPE: return "arithmetic error";
    case SIGILL: return "illegal instruction";
    case SIGKILL: return "killed from outside, or no memory was left";
    case SIGTERM: return "terminated from outside";
    case SIGTRAP: return "trap";
    case SIGSYS: return "a system call that is not allowed";
    case SIGXCPU: return "limit of processor time";
    case SIGXFSZ: return "limit of file size";
    case SIGPIPE: return "broken pipe";
    default: return "see signal(7)";
    }
}

/* Whether the process has ended; it is not reaped. `how` may be null. */
static int has_ended(const Proxy *p, char *how, size_t size)
{
    siginfo_t seen;
    memset(&seen, 0, sizeof seen);
    int failed;
    while ((failed = waitid(P_PID, (id_t)p->process, &seen, WEXITED | WNOHANG | WNOWAIT)) != 0 && errno == EINTR)
        ;
    if (failed) { /* someone else reaped it, or the system does: SIGCHLD is ignored in this program */
        if (how)
            snprintf(how, size, "the process of the FMU ended");
        return 1;
    }
    if (seen.si_pid == 0)
        return 0;
    if (how && seen.si_code == CLD_EXITED)
        snprintf(how, size, "the process of the FMU ended itself with exit(%d)", seen.si_status);
    else if (how)
        snprintf(how, size, "the process of the FMU ended by signal %d (%s)", seen.si_status,
                 signal_name(seen.si_status));
    return 1;
}

/* Ends what is left: the process, and those that it started. */
static void reap(Proxy *p)
{
    if (p->process <= 0)
        return;
    int is_ours = 1, is_done = 0;
    siginfo_t seen;
    if (waitid(P_PID, (id_t)p->process, &seen, WEXITED | WNOHANG | WNOWAIT) != 0 && errno == ECHILD)
        is_ours = 0; /* its number may be another's by now */
    if (is_ours) {
        /* It leads its group, and keeps the group's number from others until it is reaped. */
        kill(-p->process, SIGKILL);
        kill(p->process, SIGKILL);
        /* A process that hangs in the system (a dead network drive) cannot be killed, and nobody waits for that. */
        for (int k = 0; k < 3000 && !is_done; k++) {
            const pid_t found = waitpid(p->process, NULL, WNOHANG);
            is_done = found == p->process || (found < 0 && errno != EINTR);
            if (!is_done)
                nanosleep(&(struct timespec){0, k < 100 ? 20000 : 1000000}, NULL);
        }
    }
    p->process = 0;
}

#if defined __GNUC__
__attribute__((format(printf, 2, 3)))
#endif
static void lose(Proxy *p, const char *format, ...)
{
    va_list rest;
    va_start(rest, format);
    vsnprintf(p->why, sizeof p->why, format, rest);
    va_end(rest);
    p->is_lost = 1;
    reap(p);
    if (p->tell)
        p->tell(p, STATUS_FATAL, "logStatusFatal", p->why);
}

/* --- the memory ---- */

static void *place(const Proxy *p, size_t at)
{
    return (char *)p->head + at;
}

static int mapped_again(Proxy *p, size_t bytes)
{
    void *made = mremap(p->head, p->bytes, bytes, MREMAP_MAYMOVE);
    if (made == MAP_FAILED)
        return -1;
    p->head = made;
    p->bytes = bytes;
    return 0;
}

/* At least `bytes`; more where it is cheaper later. */
static int grow(Proxy *p, size_t bytes)
{
    size_t wanted = 2 * p->bytes;
    while (wanted < bytes)
        wanted *= 2;
    /* Not ftruncate: memory that is not there is an error now, and not a signal later. */
    int failed;
    while ((failed = posix_fallocate(p->file, 0, (off_t)wanted)) == EINTR)
        ;
    if (failed || mapped_again(p, wanted))
        return -1;
    p->head->bytes = wanted;
    return 0;
}

/* The other side may have let the file grow. */
static int follow(Proxy *p)
{
    const uint64_t told = p->head->bytes;
    struct stat found;
    if (told == p->bytes)
        return 0;
    if (told < p->bytes || told > (uint64_t)1 << 46 || fstat(p->file, &found) || (uint64_t)found.st_size < told)
        return -1;
    return mapped_again(p, told);
}

static int is_inside(const Proxy *p, Span span)
{
    return span.at >= sizeof(Head) && span.at <= p->bytes && span.bytes <= p->bytes - span.at;
}

/* --- starting ---- */

static int spawn(Proxy *p, const char *fmi, uint64_t *load_timeout)
{
    char owner[32];
    const char *texts[LIBRARIES + 8], *at = blocks_proxy_settings;
    int n = 0;
    for (; *at && n < LIBRARIES + 4; at += strlen(at) + 1)
        texts[n++] = at;
    if (n < 4) {
        snprintf(p->why, sizeof p->why, "this library belongs to no FMU");
        return -1;
    }
    p->timeout = strtoull(texts[1], NULL, 10);
    *load_timeout = strtoull(texts[2], NULL, 10);
    snprintf(owner, sizeof owner, "%ld", (long)p->owner);
    const char *arguments[LIBRARIES + 8] = {texts[0], fmi, owner};
    for (int k = 3; k <= n; k++)
        arguments[k] = k < n ? texts[k] : NULL;

    posix_spawn_file_actions_t files;
    posix_spawnattr_t settings;
    sigset_t none, all;
    sigemptyset(&none);
    sigfillset(&all);
    posix_spawn_file_actions_init(&files);
    posix_spawnattr_init(&settings);
    posix_spawn_file_actions_adddup2(&files, p->file, CHANNEL);
    posix_spawnattr_setsigmask(&settings, &none);
    posix_spawnattr_setsigdefault(&settings, &all);
    /* A session of its own: Ctrl-C in a terminal goes to the importer, and what the FMU starts is of one group. */
    posix_spawnattr_setflags(&settings, POSIX_SPAWN_SETSID | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    int failed = 0;
    /* Another thread that forks may hold the host, which was just written, open for a moment. */
    for (int k = 0; k < 100; k++) {
        failed = posix_spawn(&p->process, texts[0], &files, &settings, (char *const *)(uintptr_t)arguments, environ);
        if (failed != ETXTBSY)
            break;
        nanosleep(&(struct timespec){0, 1000000}, NULL);
    }
    posix_spawn_file_actions_destroy(&files);
    posix_spawnattr_destroy(&settings);
    if (failed) {
        p->process = 0;
        snprintf(p->why, sizeof p->why, "no process could be started: %s", strerror(failed));
        return -1;
    }
    return 0;
}

static int open_channel(Proxy *p)
{
    p->file = memfd_create("blocks-fmu", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (p->file < 0)
        return -1;
    /* A file that shrinks would end the importer by a signal. */
    if (posix_fallocate(p->file, 0, FIRST_BYTES) || fcntl(p->file, F_ADD_SEALS, F_SEAL_SHRINK))
        return -1;
    void *made = mmap(NULL, FIRST_BYTES, PROT_READ | PROT_WRITE, MAP_SHARED, p->file, 0);
    if (made == MAP_FAILED)
        return -1;
    p->head = made;
    p->bytes = FIRST_BYTES;
    p->head->bytes = FIRST_BYTES;
    atomic_store(&p->head->turn, ANSWER);
    return 0;
}

static void release(Proxy *p)
{
    reap(p);
    if (p->head)
        munmap(p->head, p->bytes);
    if (p->file >= 0)
        close(p->file);
    free(p->text);
    p->head = NULL;
    p->file = -1;
    p->text = NULL;
}

int proxy_start(Proxy *p, const char *fmi)
{
    uint64_t load_timeout = 0;
    p->file = -1;
    p->owner = getpid();
    p->patience = channel_patience();
    p->top = channel_aligned(sizeof(Head));
    last_failure[0] = '\0';
    if (open_channel(p)) {
        lose(p, "no memory could be shared with another process: %s", strerror(errno));
    } else if (spawn(p, fmi, &load_timeout)) {
        char why[sizeof p->why];
        memcpy(why, p->why, sizeof why);
        lose(p, "%s", why);
    } else {
        const uint64_t timeout = p->timeout;
        p->timeout = load_timeout;
        const int status = proxy_call(p, &(Request){.function = LOAD, .name = "loading"}, (Array[]){{"", NULL, 1}}, 1);
        p->timeout = timeout;
        size_t bytes = 0;
        if (status != STATUS_OK && !p->is_lost) {
            const char *said = proxy_reply(p, 0, &bytes);
            lose(p, "%.*s", (int)(bytes < 400 ? bytes : 400), said ? said : "its binary cannot be loaded");
        }
    }
    if (!p->is_lost)
        return 0;
    memcpy(last_failure, p->why, sizeof last_failure);
    release(p);
    return -1;
}

/* --- calls ---- */

/* Waits for the other side. -1: it is lost. */
static int await(Proxy *p, const char *name, uint64_t deadline)
{
    char how[160];
    if (channel_spin(p->head, 0, &p->patience))
        return 0;
    for (uint64_t nap = MS;; nap = nap * 2 < LONGEST_SLEEP ? nap * 2 : LONGEST_SLEEP) {
        if (has_ended(p, how, sizeof how)) {
            if (atomic_load(&p->head->turn) % 2 == 0) /* it had answered before */
                return 0;
            const int is_begun = atomic_load(&p->head->taken) == p->calls;
            lose(p, "%s %s %s", how, is_begun ? "in" : "before", name);
            return -1;
        }
        const uint64_t now = deadline ? channel_now() : 0;
        if (deadline && now >= deadline) {
            if (atomic_load(&p->head->turn) % 2 == 0) /* this process was stopped meanwhile, and not the other one */
                return 0;
            lose(p, "no answer within %g s in %s; its process was ended", (double)p->timeout * 1e-9, name);
            return -1;
        }
        const uint64_t rest = deadline && deadline - now < nap ? deadline - now : nap;
        if (channel_sleep(p->head, 0, &p->head->importer_sleeps, rest))
            return 0;
    }
}

static void give(Proxy *p, uint32_t turn)
{
    channel_give(p->head, turn, &p->head->host_sleeps);
}

/* A text that the other side put into the span of a frame; it must end inside of it. */
static const char *text_of(const Proxy *p, Span span)
{
    return is_inside(p, span) && span.bytes && memchr(place(p, span.at), 0, span.bytes) ? place(p, span.at) : NULL;
}

/* The callback whose frame is at `at`. -1: that is no callback. */
static int call_back(Proxy *p, size_t at)
{
    Frame asked;
    if (at + sizeof asked > p->bytes)
        return -1;
    memcpy(&asked, place(p, at), sizeof asked);
    if (asked.bytes < sizeof asked || asked.bytes > p->bytes - at)
        return -1;
    const size_t top = p->top;
    p->top = channel_aligned(at + asked.bytes);
    if (asked.function == LOG) {
        const char *category = text_of(p, asked.a[0]), *message = text_of(p, asked.a[1]);
        if (!category || !message)
            return -1;
        /* The importer may call from its logger, and the memory may move: it gets copies. */
        char *copy = strdup(message), *kind = strdup(category);
        if (copy && kind && p->tell)
            p->tell(p, asked.status, kind, copy);
        free(copy);
        free(kind);
    } else if (asked.function == UPDATE) {
        int early = asked.n[4] != 0;
        double early_time = asked.x[1];
        if (p->update)
            p->update(p, &asked, &early, &early_time);
        if (p->is_lost)
            return 0;
        Frame *answer = place(p, at);
        answer->n[4] = (uint64_t)(early != 0);
        answer->x[1] = early_time;
    } else {
        return -1;
    }
    p->top = top;
    return 0;
}

/* The frame of a call at `at`, with its arrays at `places`; returns where it ends, 0 where there is no room. */
static size_t lay_out(Proxy *p, size_t at, const Array *arrays, int count, size_t *places)
{
    size_t end = channel_aligned(at + sizeof(Frame));
    for (int k = 0; k < count; k++) {
        if (arrays[k].bytes > (size_t)1 << 44)
            return 0;
        places[k] = arrays[k].in ? end : 0;
        end = channel_aligned(end + (arrays[k].in ? arrays[k].bytes : 0));
    }
    return end <= p->bytes || grow(p, end) == 0 ? end : 0;
}

int proxy_call(Proxy *p, const Request *request, const Array *arrays, int count)
{
    size_t places[SPANS];
    if (!p)
        return STATUS_ERROR;
    if (p->is_lost || p->owner != getpid()) /* a copy of this process has no part in the channel */
        return STATUS_FATAL;
    const size_t at = p->top, end = lay_out(p, at, arrays, count, places);
    if (!end)
        return proxy_refuse(p, request->name, "there is no memory for its arrays");
    Frame *frame = place(p, at);
    memset(frame, 0, sizeof *frame);
    frame->bytes = end - at;
    frame->function = request->function;
    memcpy(frame->n, request->n, sizeof frame->n);
    memcpy(frame->x, request->x, sizeof frame->x);
    for (int k = 0; k < count; k++) {
        frame->a[k] = (Span){places[k], arrays[k].in ? arrays[k].bytes : 0};
        /* Also what is only written there: where the FMU does not, the importer's values stay. */
        if (arrays[k].in && arrays[k].bytes)
            memcpy(place(p, places[k]), arrays[k].in, arrays[k].bytes);
    }
    p->head->frame = at;
    p->calls++;
    give(p, CALL);
    uint64_t deadline = p->timeout ? channel_now() + p->timeout : 0;
    for (;;) {
        if (await(p, request->name, deadline))
            return STATUS_FATAL;
        if (follow(p))
            break;
        if (atomic_load(&p->head->turn) != CALLBACK)
            goto answered;
        const uint64_t begun = channel_now();
        if (call_back(p, end))
            break;
        if (p->is_lost) /* in a call from the callback */
            return STATUS_FATAL;
        if (deadline)
            deadline += channel_now() - begun;
        give(p, RETURN);
    }
    lose(p, "the process of the FMU answered %s with nonsense: it writes to memory that is not its own", request->name);
    return STATUS_FATAL;
answered:
    for (int k = 0; k < count; k++)
        if (arrays[k].out && arrays[k].bytes)
            memcpy(arrays[k].out, place(p, places[k]), arrays[k].bytes);
    const int status = ((const Frame *)place(p, at))->status;
    if (status == STATUS_FATAL)
        p->is_fatal = 1;
    return status;
}

int proxy_refuse(Proxy *p, const char *name, const char *what)
{
    char message[256];
    if (!p)
        return STATUS_ERROR;
    snprintf(message, sizeof message, "%s: %s", name, what);
    if (p->tell)
        p->tell(p, STATUS_ERROR, "logStatusError", message);
    return STATUS_ERROR;
}

/* --- ending ---- */

void proxy_end(Proxy *p, const Request *free_instance)
{
    if (p->owner != getpid()) {
        p->process = 0; /* the parent's */
    } else if (!p->is_lost && !p->is_fatal) {
        proxy_call(p, free_instance, NULL, 0);
        /* What its libraries do at the end is done, such as writing out files; but it is not waited for for long. */
        const uint64_t most = p->timeout && p->timeout < 2000 * MS ? p->timeout : 2000 * MS, begun = channel_now();
        for (long nap = 20000; p->process && !has_ended(p, NULL, 0) && channel_now() - begun < most;) {
            nanosleep(&(struct timespec){0, nap}, NULL);
            nap = nap < 2000000 ? nap * 2 : nap;
        }
    }
    release(p);
}

void proxy_abandon(Proxy *p)
{
    memcpy(last_failure, p->why, sizeof last_failure);
    release(p);
}

/* --- strings ---- */

const char *proxy_reply(Proxy *p, int k, size_t *bytes)
{
    const Span span = ((const Frame *)place(p, p->top))->a[k];
    if (!is_inside(p, span) || !span.bytes)
        return NULL;
    *bytes = span.bytes;
    return place(p, span.at);
}

int proxy_take_strings(Proxy *p, int k, const char *values[], size_t n)
{
    size_t bytes = 0;
    const char *from = n ? proxy_reply(p, k, &bytes) : NULL;
    if (!from)
        return n ? -1 : 0;
    char *text = malloc(bytes), *at = text;
    if (!text)
        return -1;
    memcpy(text, from, bytes);
    for (size_t i = 0; i < n; i++) {
        char *end = memchr(at, 0, bytes - (size_t)(at - text));
        if (!end) {
            free(text);
            return -1;
        }
        values[i] = at;
        at = end + 1;
    }
    free(p->text);
    p->text = text;
    return 0;
}

char *proxy_join(const char *const strings[], size_t n, size_t *bytes)
{
    size_t sum = 0;
    for (size_t i = 0; i < n; i++) {
        if (!strings[i])
            return NULL;
        sum += strlen(strings[i]) + 1;
    }
    char *made = malloc(sum ? sum : 1), *at = made;
    for (size_t i = 0; made && i < n; i++) {
        const size_t length = strlen(strings[i]) + 1;
        memcpy(at, strings[i], length);
        at += length;
    }
    *bytes = sum;
    return made;
}

size_t proxy_length(const char *string)
{
    return string ? strlen(string) + 1 : 0;
}
