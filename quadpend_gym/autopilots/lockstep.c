/* SPDX-License-Identifier: MIT OR GPL-3.0-or-later
 *
 * Runs an unmodified Betaflight SITL on a virtual clock, in lockstep with a simulator. Preloaded into its process:
 *
 *     cc -O2 -shared -fPIC -o lockstep.so lockstep.c -ldl
 *     LD_PRELOAD=./lockstep.so LOCKSTEP_CHANNEL=3 betaflight_4.6.0_SITL
 *
 * The main loop of the firmware is `scheduler(); nanosleep(50 us)`. Here nanosleep() advances the virtual clock instead
 * of waiting. When the clock reaches the end of a step, it sends the motor outputs through the inherited socket
 * LOCKSTEP_CHANNEL (a datagram of 16 floats, 1000 to 2000) and waits for the next `struct message`. The threads of the
 * firmware become coroutines: those that receive state and radio packets run only then. So the process has one thread,
 * and nothing depends on the speed of the machine. A message that comes with a file descriptor forks the process: the
 * child goes on from this moment and uses the descriptor as its channel. A closed channel ends the process.
 *
 * With LOCKSTEP_CLI there are no such messages. The first serial port, which accepts the command line (CLI), listens on a
 * free TCP port of 127.0.0.1, whose number is sent when the main loop begins. No other port is opened in either mode.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

enum { TCP, STATE, RADIO, COROUTINES }; /* the threads, in the order in which the firmware creates them */
enum { STATE_SIZE = 144, RADIO_SIZE = 40, MOTORS_PORT = 9001, MOTORS_SIZE = 68, STACK = 1 << 18 };

static const uint64_t READ_NS = 100; /* that reading the clock takes: a loop that waits for a time must end */
static const uint64_t LOOP_NS = 30000; /* that the pause of 50 us in the main loop takes; 20 us are left for the tasks */
static const long PAUSE_NS = 50000;

struct message {
    uint64_t step_ns; /* how long the firmware runs until it answers */
    char state[STATE_SIZE], radio[RADIO_SIZE]; /* `fdm_packet` and `rc_packet` of the firmware */
};

static int channel = -1, in_cli, in_main_loop, threads;
static uint64_t now = 1000000000, end_of_step;
static in_port_t cli_port;
static struct message message;
static float motors[16];
static ucontext_t main_context, contexts[COROUTINES];
static void *(*entries[COROUTINES])(void *);
static int running = -1; /* the coroutine that runs */

#define REAL(function) ((__typeof__(&function))dlsym(RTLD_NEXT, #function))

__attribute__((constructor)) static void start(void) {
    const char *text = getenv("LOCKSTEP_CHANNEL");
    channel = text ? atoi(text) : -1;
    in_cli = getenv("LOCKSTEP_CLI") != NULL;
    signal(SIGCHLD, SIG_IGN); /* the system forgets forked processes when they end */
}

static void run(int coroutine) {
    running = coroutine;
    swapcontext(&main_context, &contexts[coroutine]);
    running = -1;
}

static void begin(int coroutine) {
    entries[coroutine](NULL);
    _exit(1); /* the entry has an endless loop */
}

/* Receive the next message; the children of forks return from here too. */
static void receive(void) {
    for (;;) {
        char control[CMSG_SPACE(sizeof(int))];
        struct iovec part = {&message, sizeof message};
        struct msghdr header = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = control, .msg_controllen = sizeof control};
        if (recvmsg(channel, &header, 0) != sizeof message) _exit(0);
        struct cmsghdr *descriptor = CMSG_FIRSTHDR(&header);
        if (!descriptor) return;
        int given;
        memcpy(&given, CMSG_DATA(descriptor), sizeof given);
        if (fork() == 0) {
            close(channel);
            channel = given;
        } else {
            close(given);
        }
    }
}

static void exchange(void) {
    if (end_of_step && send(channel, motors, sizeof motors, MSG_NOSIGNAL) != sizeof motors) _exit(0);
    receive();
    end_of_step = now + message.step_ns;
    run(RADIO);
    run(STATE);
}

int nanosleep(const struct timespec *time, struct timespec *left) {
    (void)left;
    int is_pause = time->tv_sec == 0 && time->tv_nsec == PAUSE_NS;
    uint64_t wake = now + (is_pause ? LOOP_NS : 1000000000 * (uint64_t)time->tv_sec + (uint64_t)time->tv_nsec);
    if (is_pause && in_cli) {
        if (!in_main_loop) send(channel, &cli_port, sizeof cli_port, MSG_NOSIGNAL);
        run(TCP);
    }
    in_main_loop |= is_pause; /* what comes before it would be lost */
    while (in_main_loop && !in_cli && wake >= end_of_step) {
        if (now < end_of_step) now = end_of_step;
        exchange();
    }
    if (now < wake) now = wake;
    return 0;
}

int clock_gettime(clockid_t clock, struct timespec *time) {
    if (clock != CLOCK_MONOTONIC) return REAL(clock_gettime)(clock, time);
    now += READ_NS;
    time->tv_sec = (time_t)(now / 1000000000);
    time->tv_nsec = (long)(now % 1000000000);
    return 0;
}

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*entry)(void *), void *argument) {
    (void)attributes, (void)argument;
    int i = threads++;
    if (i >= COROUTINES) return EAGAIN;
    *thread = pthread_self();
    entries[i] = entry;
    getcontext(&contexts[i]);
    contexts[i].uc_stack.ss_sp = malloc(STACK);
    contexts[i].uc_stack.ss_size = STACK;
    makecontext(&contexts[i], (void (*)(void))begin, 1, i);
    run(i); /* up to its first select() */
    return 0;
}

int select(int count, fd_set *read, fd_set *write, fd_set *except, struct timeval *timeout) {
    if (running < 0) return REAL(select)(count, read, write, except, timeout);
    int is_tcp = running == TCP;
    swapcontext(&contexts[running], &main_context);
    struct timeval none = {0, 0};
    return is_tcp ? REAL(select)(count, read, write, except, &none) : 1; /* a packet has come */
}

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *address, socklen_t *length) {
    if (running < 0) return REAL(recvfrom)(fd, data, size, flags, address, length);
    memcpy(data, running == STATE ? message.state : message.radio, size);
    return (ssize_t)size;
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *address, socklen_t length) {
    (void)fd, (void)flags, (void)length;
    if (ntohs(((const struct sockaddr_in *)address)->sin_port) == MOTORS_PORT && size == MOTORS_SIZE)
        memcpy(motors, (const char *)data + sizeof(float), sizeof motors); /* their number is before them */
    return (ssize_t)size;
}

int bind(int fd, const struct sockaddr *address, socklen_t length) {
    (void)fd, (void)address, (void)length;
    return 0;
}

int listen(int fd, int backlog) {
    if (!in_cli || cli_port) return 0;
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t length = sizeof address;
    if (REAL(bind)(fd, (struct sockaddr *)&address, length) || REAL(listen)(fd, backlog)) return -1;
    int failed = getsockname(fd, (struct sockaddr *)&address, &length);
    cli_port = address.sin_port;
    return failed;
}
