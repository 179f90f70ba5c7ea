/* A preloaded library: the write number TORTURE_WRITE to a file under the folder TORTURE_FOLDER fails with the error
 * TORTURE_ERROR, once or, with TORTURE_FOREVER=1, from then on. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static atomic_long n_writes;

static int fails(int descriptor)
{
    const char *folder = getenv("TORTURE_FOLDER"), *number = getenv("TORTURE_WRITE"), *error = getenv("TORTURE_ERROR");
    char link[64], path[4096];
    if (folder == NULL || number == NULL || error == NULL)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0 || strncmp(path, folder, strlen(folder)) != 0)
        return 0;
    long n = ++n_writes;
    if (n != atol(number) && !(getenv("TORTURE_FOREVER") != NULL && n > atol(number)))
        return 0;
    errno = atoi(error);
    return 1;
}

ssize_t write(int descriptor, const void *data, size_t n_bytes)
{
    static ssize_t (*original)(int, const void *, size_t);
    if (original == NULL)
        original = (ssize_t (*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write");
    return fails(descriptor) ? -1 : original(descriptor, data, n_bytes);
}
