/* Gives the pseudo-terminal behind a ser2net the DTR that it lacks: LD_PRELOAD. A rising edge runs $RESET.
   Without headers, so that a compiler alone is enough (tcc); the numbers are Linux's. */
enum { MODEM_GET = 0x5415, MODEM_SET_BITS, MODEM_CLEAR_BITS, MODEM_SET, DTR = 2, RTS = 4 };

void *dlsym(void *library, const char *name);
char *getenv(const char *name);
int system(const char *command);

static int lines = DTR | RTS;

static int set(int now)
{
    int rose = (now & DTR) && !(lines & DTR);
    lines = now;
    return rose ? system(getenv("RESET")) : 0;
}

int ioctl(int fd, unsigned long request, void *argument)
{
    int (*next)(int, unsigned long, ...) = dlsym((void *)-1L, "ioctl");
    switch (request) {
    case MODEM_GET: *(int *)argument = lines; return 0;
    case MODEM_SET: return set(*(int *)argument);
    case MODEM_SET_BITS: return set(lines | *(int *)argument);
    case MODEM_CLEAR_BITS: return set(lines & ~*(int *)argument);
    }
    return next(fd, request, argument);
}
