/* The wall clock of one process tree, off by CLOCK_SKEW seconds, from the second CLOCK_SKEW_FROM of the monotonic clock on if that
   is stated; every other clock stays true. Built and preloaded by the tests.
   (libfaketime also bends the monotonic clock and absolute sleeps, which no machine with a wrong wall clock does.) */
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long skew(void) {
    const char *text = getenv("CLOCK_SKEW"), *from = getenv("CLOCK_SKEW_FROM");
    struct timespec now;
    if (from && (syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &now) || now.tv_sec < atol(from))) return 0;
    return text ? atol(text) : 0;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = syscall(SYS_clock_gettime, clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) now->tv_sec += skew();
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec exact;
    (void)zone;
    if (clock_gettime(CLOCK_REALTIME, &exact)) return -1;
    now->tv_sec = exact.tv_sec;
    now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *place) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    if (place) *place = exact.tv_sec;
    return exact.tv_sec;
}
