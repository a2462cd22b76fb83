/* Gives the pseudo-terminal behind a ser2net the DTR that it lacks: LD_PRELOAD. A rising edge runs $RESET. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdarg.h>
#include <stdlib.h>
#include <sys/ioctl.h>

static int lines = TIOCM_DTR | TIOCM_RTS;

static int set(int now)
{
    int rose = (now & TIOCM_DTR) && !(lines & TIOCM_DTR);
    lines = now;
    return rose ? system(getenv("RESET")) : 0;
}

int ioctl(int fd, unsigned long request, ...)
{
    int (*real)(int, unsigned long, ...) = dlsym(RTLD_NEXT, "ioctl");
    va_list rest;
    va_start(rest, request);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    switch (request) {
    case TIOCMGET: *(int *)argument = lines; return 0;
    case TIOCMSET: return set(*(int *)argument);
    case TIOCMBIS: return set(lines | *(int *)argument);
    case TIOCMBIC: return set(lines & ~*(int *)argument);
    }
    return real(fd, request, argument);
}
