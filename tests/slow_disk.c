/* Preloaded into a process: each write to disk that is waited for takes SLOW_DISK_S longer, and each
 * `write` to a file SLOW_WRITE_S. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

static int take(const char *variable)
{
    const char *seconds = getenv(variable);
    if (seconds)
        usleep((useconds_t)(atof(seconds) * 1e6));
    return 0;
}

int fsync(int descriptor) { (void)descriptor; return take("SLOW_DISK_S"); }
int fdatasync(int descriptor) { (void)descriptor; return take("SLOW_DISK_S"); }

ssize_t write(int descriptor, const void *bytes, size_t count)
{
    static ssize_t (*next)(int, const void *, size_t);
    struct stat about;
    if (!next)
        next = dlsym(RTLD_NEXT, "write");
    if (fstat(descriptor, &about) == 0 && S_ISREG(about.st_mode))
        take("SLOW_WRITE_S");
    return next(descriptor, bytes, count);
}
