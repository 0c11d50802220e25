/* Ends the process at one of the calls by which a file is written: loaded before the C library (LD_PRELOAD).

   Counted are calls on files "*.part", on their names, and on folders that are opened after the first of them was.
   killed_at(n) kills at the n-th call, from 0; one that writes has then written half. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

enum { FILES = 1024 };

static long at = -1, calls;
static char is_counted[FILES], has_begun;

void killed_at(long n) { at = n; }

static void end(void) { kill(getpid(), SIGKILL), pause(); }
static int is_hit(void) { return at >= 0 && calls++ == at; }
static int counts(int file) { return file >= 0 && file < FILES && is_counted[file]; }

static int is_part(const char *path)
{
    size_t n = strlen(path);
    return n > 5 && !strcmp(path + n - 5, ".part");
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define BEFORE(wanted) if ((wanted) && is_hit()) end();

#define OPEN(name)                                                                   \
    int name(const char *path, int flags, ...)                                       \
    {                                                                                \
        va_list list;                                                                \
        va_start(list, flags);                                                       \
        mode_t mode = va_arg(list, mode_t);                                          \
        va_end(list);                                                                \
        int wanted = is_part(path) || (has_begun && flags & O_DIRECTORY);            \
        BEFORE(wanted)                                                               \
        int file = NEXT(name)(path, flags, mode);                                    \
        if (wanted && file >= 0 && file < FILES) is_counted[file] = has_begun = 1;   \
        return file;                                                                 \
    }
OPEN(open)
OPEN(open64)

ssize_t write(int file, const void *data, size_t size)
{
    if (counts(file) && is_hit()) {
        if (size > 1) (void)!NEXT(write)(file, data, size / 2);
        end();
    }
    return NEXT(write)(file, data, size);
}

int close(int file)
{
    BEFORE(counts(file))
    if (counts(file)) is_counted[file] = 0;
    return NEXT(close)(file);
}

int rename(const char *from, const char *to) { BEFORE(is_part(from)) return NEXT(rename)(from, to); }
int unlink(const char *path) { BEFORE(is_part(path)) return NEXT(unlink)(path); }
int chmod(const char *path, mode_t mode) { BEFORE(is_part(path)) return NEXT(chmod)(path, mode); }
int fsync(int file) { BEFORE(counts(file)) return NEXT(fsync)(file); }
int flock(int file, int what) { BEFORE(counts(file)) return NEXT(flock)(file, what); }
off64_t lseek64(int file, off64_t offset, int whence) { BEFORE(counts(file)) return NEXT(lseek64)(file, offset, whence); }
