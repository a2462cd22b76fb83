/* Library for LD_PRELOAD that gives the pseudo-terminal behind ser2net a DTR line; a rising edge runs $RESET.
   It includes no headers, so that tcc alone can compile it; the numbers are those of Linux. */
enum { MODEM_GET = 0x5415, MODEM_SET_BITS, MODEM_CLEAR_BITS, MODEM_SET, DTR = 2, RTS = 4 };

void *dlsym(void *library, const char *name);
char *getenv(const char *name);
int system(const char *command);

static int lines = DTR | RTS;

static int set_lines(int new_lines)
{
    int is_rising = (new_lines & DTR) && !(lines & DTR);
    lines = new_lines;
    return is_rising ? system(getenv("RESET")) : 0;
}

int ioctl(int fd, unsigned long request, void *argument)
{
    int (*next)(int, unsigned long, ...) = dlsym((void *)-1L, "ioctl");
    switch (request) {
    case MODEM_GET: *(int *)argument = lines; return 0;
    case MODEM_SET: return set_lines(*(int *)argument);
    case MODEM_SET_BITS: return set_lines(lines | *(int *)argument);
    case MODEM_CLEAR_BITS: return set_lines(lines & ~*(int *)argument);
    }
    return next(fd, request, argument);
}
