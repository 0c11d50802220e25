/* host FMI OWNER LIBRARY...: runs one instance of an FMU for the process OWNER, which shares the file CHANNEL.

   It ends with the owner, whatever the FMU does. What the FMU prints goes to stderr; it has no stdin, and nothing else
   that the owner has open. */
#define _GNU_SOURCE
#include "host.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>

struct Note {
    Note *next;
    int status;
    char *category, *message;
};

/* --- the owner's end ---- */

static void *watch(void *owner)
{
    const pid_t parent = *(const pid_t *)owner;
#if defined SYS_pidfd_open
    /* Not prctl(PR_SET_PDEATHSIG): that comes when the thread ends that started this process. */
    struct pollfd seen = {(int)syscall(SYS_pidfd_open, parent, 0), POLLIN, 0};
    while (getppid() == parent && seen.fd >= 0 && poll(&seen, 1, -1) == 0)
        ;
#endif
    while (getppid() == parent) /* where the system has no such thing, or the FMU has closed it */
        usleep(200000);
    kill(0, SIGKILL); /* and what the FMU started */
    _exit(1);
}

/* --- the file ---- */

static int map(Host *h, size_t bytes)
{
    void *made = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, CHANNEL, 0);
    if (made == MAP_FAILED)
        return -1;
    h->base = made;
    h->bytes = bytes;
    return 0;
}

static Head *head(const Host *h)
{
    return (Head *)(void *)h->base;
}

static Frame *frame_at(const Host *h, size_t at)
{
    return (Frame *)(void *)(h->base + at);
}

/* Room up to `end`. */
static int reserve(Host *h, size_t end)
{
    size_t wanted = h->bytes;
    if (end <= h->bytes)
        return 0;
    while (wanted < end)
        wanted *= 2;
    if (posix_fallocate(CHANNEL, 0, (off_t)wanted) || map(h, wanted))
        return -1;
    head(h)->bytes = wanted;
    return 0;
}

/* Waits for a call or for the end of a callback. Returns the turn. */
static uint32_t await(Host *h)
{
    if (!channel_spin(head(h), 1, &h->patience))
        while (!channel_sleep(head(h), 1, &head(h)->host_sleeps, 0))
            ;
    if (head(h)->bytes != h->bytes && map(h, head(h)->bytes))
        abort();
    return atomic_load(&head(h)->turn);
}

static void give(Host *h, uint32_t turn)
{
    channel_give(head(h), turn, &head(h)->importer_sleeps);
}

void *host_array(const Host *h, const Frame *frame, int k)
{
    return frame->a[k].at ? h->base + frame->a[k].at : NULL;
}

const char **host_strings(const Host *h, const Frame *frame, int k, size_t n)
{
    const char **made = malloc((n ? n : 1) * sizeof *made);
    const char *at = host_array(h, frame, k), *end = at ? at + frame->a[k].bytes : NULL;
    for (size_t i = 0; made && i < n; i++) {
        const char *zero = at && at < end ? memchr(at, 0, (size_t)(end - at)) : NULL;
        if (!zero) {
            free(made);
            return NULL;
        }
        made[i] = at;
        at = zero + 1;
    }
    return made;
}

int host_leave_strings(Host *h, Frame *frame, int k, const char *const strings[], size_t n)
{
    size_t bytes = 0;
    for (size_t i = 0; i < n; i++)
        bytes += (strings[i] ? strlen(strings[i]) : 0) + 1;
    if (reserve(h, h->end + bytes))
        return -1;
    char *at = h->base + h->end;
    for (size_t i = 0; i < n; i++) {
        const char *string = strings[i] ? strings[i] : "";
        memcpy(at, string, strlen(string) + 1);
        at += strlen(string) + 1;
    }
    frame->a[k] = (Span){h->end, bytes}; /* the same memory, where the frame is an earlier mapping's */
    return 0;
}

/* --- serving ---- */

static void load(Host *h, Frame *frame, char *const paths[])
{
    const char *error = NULL;
    char message[1024];
    for (int k = 0; paths[k] && !error; k++) {
        h->library = dlopen(paths[k], RTLD_NOW | RTLD_LOCAL);
        if (!h->library)
            error = dlerror();
    }
    if (h->library) {
        h->standard->find(h);
        return;
    }
    snprintf(message, sizeof message, "cannot be loaded: %s", error ? error : "no reason is known");
    host_leave_strings(h, frame, 0, (const char *const[]){message}, 1);
    frame->status = STATUS_ERROR;
}

void *host_symbol(const Host *h, const char *name)
{
    return dlsym(h->library, name);
}

int host_missing(Host *h, const char *name)
{
    char message[256];
    snprintf(message, sizeof message, "its binary has no function %s%s", h->standard->prefix, name);
    host_log(h, STATUS_ERROR, "logStatusError", message);
    return STATUS_ERROR;
}

static void tell(Host *h, int status, const char *category, const char *message);

/* Messages of other threads go before the answer. */
static void tell_notes(Host *h)
{
    for (;;) {
        pthread_mutex_lock(&h->lock);
        Note *note = h->first;
        if (note)
            h->first = note->next;
        if (!h->first)
            h->last = NULL;
        pthread_mutex_unlock(&h->lock);
        if (!note)
            return;
        tell(h, note->status, note->category, note->message);
        free(note->category);
        free(note->message);
        free(note);
    }
}

/* The call whose turn it is: inside of a callback, one in another. */
static void serve(Host *h, char *const paths[])
{
    const size_t at = h->at, end = h->end;
    const int was_working = h->is_working;
    h->at = head(h)->frame;
    Frame *frame = frame_at(h, h->at);
    h->end = channel_aligned(h->at + frame->bytes);
    h->is_working = 1;
    atomic_fetch_add(&head(h)->taken, 1);
    if (frame->function == LOAD)
        load(h, frame, paths);
    else
        frame->status = h->standard->serve(h, frame);
    fflush(stdout);
    tell_notes(h);
    h->at = at;
    h->end = end;
    h->is_working = was_working;
    give(h, ANSWER);
}

/* Has the importer called back, with a frame behind the present one; calls that it makes meanwhile are served. */
static void call_back(Host *h)
{
    give(h, CALLBACK);
    while (await(h) != RETURN)
        serve(h, NULL);
}

static void tell(Host *h, int status, const char *category, const char *message)
{
    const size_t lengths[] = {strlen(category) + 1, strlen(message) + 1};
    const size_t at = h->end, first = channel_aligned(at + sizeof(Frame));
    const size_t second = channel_aligned(first + lengths[0]), end = channel_aligned(second + lengths[1]);
    if (reserve(h, end))
        return;
    Frame *frame = frame_at(h, at);
    memset(frame, 0, sizeof *frame);
    frame->bytes = end - at;
    frame->function = LOG;
    frame->status = status;
    frame->a[0] = (Span){first, lengths[0]};
    frame->a[1] = (Span){second, lengths[1]};
    memcpy(h->base + first, category, lengths[0]);
    memcpy(h->base + second, message, lengths[1]);
    call_back(h);
}

void host_log(Host *h, int status, const char *category, const char *message)
{
    category = category ? category : "";
    message = message ? message : "";
    if (h->is_working && pthread_equal(pthread_self(), h->worker)) {
        tell(h, status, category, message);
        return;
    }
    Note *note = malloc(sizeof *note);
    if (!note)
        return;
    *note = (Note){NULL, status, strdup(category), strdup(message)};
    if (!note->category || !note->message) {
        free(note->category);
        free(note->message);
        free(note);
        return;
    }
    pthread_mutex_lock(&h->lock);
    if (h->last)
        h->last->next = note;
    else
        h->first = note;
    h->last = note;
    pthread_mutex_unlock(&h->lock);
}

void host_update(Host *h, double t, const uint64_t *flags, int *early, double *early_time)
{
    const size_t at = h->end;
    if (!pthread_equal(pthread_self(), h->worker) || reserve(h, channel_aligned(at + sizeof(Frame))))
        return;
    Frame *frame = frame_at(h, at);
    memset(frame, 0, sizeof *frame);
    frame->bytes = sizeof *frame;
    frame->function = UPDATE;
    memcpy(frame->n, flags, 4 * sizeof *flags);
    frame->n[4] = (uint64_t)(*early != 0);
    frame->x[0] = t;
    frame->x[1] = *early_time;
    call_back(h);
    *early = frame->n[4] != 0;
    *early_time = frame->x[1];
}

/* --- states ---- */

int host_state(const Host *h, uint64_t number, void **state)
{
    *state = number && number <= h->nstates ? h->states[number - 1] : NULL;
    return number && !*state ? -1 : 0;
}

int host_without_state(Host *h)
{
    host_log(h, STATUS_ERROR, "logStatusError", "there is no such state of the FMU");
    return STATUS_ERROR;
}

uint64_t host_keep(Host *h, uint64_t number, void *state)
{
    if (number) {
        h->states[number - 1] = state;
        return state ? number : 0;
    }
    if (!state)
        return 0;
    size_t k = 0;
    while (k < h->nstates && h->states[k])
        k++;
    if (k == h->nstates) {
        const size_t n = h->nstates ? 2 * h->nstates : 8;
        void **made = realloc(h->states, n * sizeof *made);
        if (!made)
            return 0;
        memset(made + h->nstates, 0, (n - h->nstates) * sizeof *made);
        h->states = made;
        h->nstates = n;
    }
    h->states[k] = state;
    return k + 1;
}

/* --- the process ---- */

static void close_from(int first)
{
#if defined SYS_close_range
    if (syscall(SYS_close_range, (unsigned)first, ~0u, 0) == 0)
        return;
#endif
    const long most = sysconf(_SC_OPEN_MAX);
    for (int file = first; file < (most > 0 ? most : 1024); file++)
        close(file);
}

static void set_up_process(void)
{
    const int nothing = open("/dev/null", O_RDWR | O_CLOEXEC);
    dup2(nothing, 0);
    if (fcntl(2, F_GETFD) < 0)
        dup2(nothing, 2);
    dup2(2, 1);
    close_from(CHANNEL + 1);
    setvbuf(stdout, NULL, _IOLBF, 0);
    signal(SIGINT, SIG_IGN);
    /* A crash is told by a sentence, and leaves no file behind; 1, as with 0 programs that take core dumps are started,
       which takes seconds: core(5). */
    setrlimit(RLIMIT_CORE, &(struct rlimit){1, 1});
}

int main(int count, char **words)
{
    static pid_t owner;
    Host h = {.patience = channel_patience(), .lock = PTHREAD_MUTEX_INITIALIZER};
    if (count < 4) {
        fputs("This program is started by blocks, for an FMU that runs in a process of its own.\n", stderr);
        return 2;
    }
    set_up_process();
    h.standard = words[1][0] == '2' ? &host_fmi2 : &host_fmi3;
    owner = (pid_t)strtol(words[2], NULL, 10);
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_BLOCK, &all, &before);
    pthread_t watcher;
    if (pthread_create(&watcher, NULL, watch, &owner))
        return 2;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    h.worker = pthread_self();
    if (map(&h, FIRST_BYTES))
        return 2;
    h.end = channel_aligned(sizeof(Head));
    while (!h.is_over) {
        await(&h);
        serve(&h, words + 3);
    }
    exit(0);
}
