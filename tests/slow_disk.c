/* Preloaded into a process: each write to disk that is waited for takes SLOW_DISK_S longer. */
#include <stdlib.h>
#include <unistd.h>

static int wait_for_disk(void)
{
    const char *seconds = getenv("SLOW_DISK_S");
    if (seconds)
        usleep((useconds_t)(atof(seconds) * 1e6));
    return 0;
}

int fsync(int descriptor) { (void)descriptor; return wait_for_disk(); }
int fdatasync(int descriptor) { (void)descriptor; return wait_for_disk(); }
