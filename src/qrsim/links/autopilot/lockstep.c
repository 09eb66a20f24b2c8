/* Preloaded into Betaflight's SITL, makes it a function of its inputs: its clock goes on only as far as it is told.

   The firmware's main loop sleeps for 50 us at its end. Here that sleep moves a clock of our own; once the clock is
   where it was told to go, the motors' last packet is sent to the simulator and the next message awaited. The threads
   that read the packets of states and of sticks are handed what has come, and are through with it before the main loop
   goes on. So nothing depends on how fast anybody runs.

   Nothing of the firmware is in here: it is known by the calls of the C library that it makes, and by their ports.
   Sockets of packets are never bound, and the port of its command line is one that is free: any number can run.

   Environment: QRSIM_LOCKSTEP_FD, a stream socket to the simulator; QRSIM_LOCKSTEP_FREE=1: leave the clock alone.
   To the simulator: first the port of the command line (uint32), then for each message four floats, the motors.
   From it: 144 bytes of state and 40 of sticks, each with the time [s] at its beginning. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <netinet/in.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { MOTORS_PORT = 9002, STATE_PORT = 9003, STICKS_PORT = 9004, RAW_PORT = 9001 };
enum { STATE_BYTES = 144, STICKS_BYTES = 40, MOTOR_BYTES = 16 };

/* Virtual time until which the firmware starts up by itself: it has read its configuration and opened its ports. */
static const uint64_t BOOT_NS = 4000000000ull;

/* A thread that waits for packets at a socket. */
struct reader {
    int fd;
    size_t size;
    unsigned char bytes[STATE_BYTES];
    int waiting, full;
};

static struct reader state = {.fd = -1, .size = STATE_BYTES}, sticks = {.fd = -1, .size = STICKS_BYTES};
static unsigned char motors[MOTOR_BYTES];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;
static uint64_t now_ns = 1000000000ull, target_ns, start_ns;
static double start_s;
static int control = -1, stepping, told, answered = 1;

static int (*real_clock_gettime)(clockid_t, struct timespec *);
static int (*real_nanosleep)(const struct timespec *, struct timespec *);
static int (*real_select)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
static ssize_t (*real_recvfrom)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
static ssize_t (*real_sendto)(int, const void *, size_t, int, const struct sockaddr *, socklen_t);
static int (*real_bind)(int, const struct sockaddr *, socklen_t);
static int (*real_listen)(int, int);
static sighandler_t (*real_signal)(int, sighandler_t);

__attribute__((constructor)) static void begin(void) {
    real_clock_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    real_nanosleep = dlsym(RTLD_NEXT, "nanosleep");
    real_select = dlsym(RTLD_NEXT, "select");
    real_recvfrom = dlsym(RTLD_NEXT, "recvfrom");
    real_sendto = dlsym(RTLD_NEXT, "sendto");
    real_bind = dlsym(RTLD_NEXT, "bind");
    real_listen = dlsym(RTLD_NEXT, "listen");
    real_signal = dlsym(RTLD_NEXT, "signal");
    const char *number = getenv("QRSIM_LOCKSTEP_FD");
    if (number) control = atoi(number);
    stepping = control >= 0 && !getenv("QRSIM_LOCKSTEP_FREE");
}

static void put(const void *bytes, size_t size) {
    const char *next = bytes;
    while (size) {
        ssize_t count = send(control, next, size, MSG_NOSIGNAL);
        if (count <= 0) _exit(0); /* the simulator has gone */
        next += count;
        size -= count;
    }
}

static void get(void *bytes, size_t size) {
    char *next = bytes;
    while (size) {
        ssize_t count = recv(control, next, size, 0);
        if (count <= 0) _exit(0);
        next += count;
        size -= count;
    }
}

/* Hand over a packet and wait until the thread is back for the next one; called with the lock held. */
static void deliver(struct reader *reader, const unsigned char *bytes) {
    while (!reader->waiting) pthread_cond_wait(&changed, &lock);
    memcpy(reader->bytes, bytes, reader->size);
    reader->waiting = 0;
    reader->full = 1;
    pthread_cond_broadcast(&changed);
    while (!reader->waiting) pthread_cond_wait(&changed, &lock);
}

/* Answer the last message, take the next one, and set how far the clock may go. */
static void exchange(void) {
    unsigned char message[STATE_BYTES + STICKS_BYTES];
    static unsigned char last[STICKS_BYTES];
    double time_s;
    if (!answered) put(motors, sizeof motors);
    get(message, sizeof message);
    memcpy(&time_s, message, sizeof time_s);
    pthread_mutex_lock(&lock);
    if (!told) {
        start_s = time_s;
        start_ns = now_ns;
    }
    /* Sticks are kept until others come, and the time before them is not looked at. */
    const unsigned char *new_sticks = message + STATE_BYTES;
    if (!told || memcmp(last + 8, new_sticks + 8, STICKS_BYTES - 8)) deliver(&sticks, new_sticks);
    memcpy(last, new_sticks, STICKS_BYTES);
    told = 1;
    deliver(&state, message);
    target_ns = start_ns + (uint64_t)((time_s - start_s) * 1e9 + 0.5);
    answered = 0;
    pthread_mutex_unlock(&lock);
}

int clock_gettime(clockid_t id, struct timespec *time) {
    if (!stepping || id != CLOCK_MONOTONIC) return real_clock_gettime(id, time);
    uint64_t ns = __atomic_load_n(&now_ns, __ATOMIC_SEQ_CST);
    time->tv_sec = ns / 1000000000ull;
    time->tv_nsec = ns % 1000000000ull;
    return 0;
}

static int listening, noted;

int nanosleep(const struct timespec *duration, struct timespec *left) {
    const int main_thread = syscall(SYS_gettid) == getpid();
    if (main_thread && __atomic_load_n(&listening, __ATOMIC_SEQ_CST)) __atomic_store_n(&noted, 1, __ATOMIC_SEQ_CST);
    if (!stepping || !main_thread) return real_nanosleep(duration, left);
    uint64_t wake_ns = now_ns + duration->tv_sec * 1000000000ull + duration->tv_nsec;
    if (wake_ns <= BOOT_NS) {
        __atomic_store_n(&now_ns, wake_ns, __ATOMIC_SEQ_CST);
        return 0;
    }
    if (!told) target_ns = now_ns;
    while (wake_ns > target_ns) {
        __atomic_store_n(&now_ns, target_ns, __ATOMIC_SEQ_CST);
        exchange();
    }
    __atomic_store_n(&now_ns, wake_ns, __ATOMIC_SEQ_CST);
    return 0;
}

static struct reader *reader_of(int fd) {
    return fd < 0 ? NULL : fd == state.fd ? &state : fd == sticks.fd ? &sticks : NULL;
}

int listen(int fd, int backlog) {
    int failed = real_listen(fd, backlog);
    __atomic_store_n(&listening, 1, __ATOMIC_SEQ_CST);
    return failed;
}

/* The thread of the command line throws away sockets that do not listen yet, the main thread's new one among them: it
   is held back from its beginning, where it says that it ignores SIGPIPE, until that listens and the main thread, which
   notes it, has come to its next sleep. */
sighandler_t signal(int number, sighandler_t handler) {
    const struct timespec moment = {0, 1000000};
    if (control >= 0 && number == SIGPIPE && syscall(SYS_gettid) != getpid())
        while (!__atomic_load_n(&noted, __ATOMIC_SEQ_CST)) real_nanosleep(&moment, NULL);
    return real_signal(number, handler);
}

int select(int count, fd_set *in, fd_set *out, fd_set *errors, struct timeval *limit) {
    struct reader *reader = stepping && in ? reader_of(count - 1) : NULL;
    if (!reader || !FD_ISSET(reader->fd, in)) return real_select(count, in, out, errors, limit);
    pthread_mutex_lock(&lock);
    reader->waiting = 1;
    pthread_cond_broadcast(&changed);
    while (!reader->full) pthread_cond_wait(&changed, &lock);
    pthread_mutex_unlock(&lock);
    return 1;
}

ssize_t recvfrom(int fd, void *bytes, size_t size, int flags, struct sockaddr *from, socklen_t *length) {
    struct reader *reader = stepping ? reader_of(fd) : NULL;
    if (!reader) return real_recvfrom(fd, bytes, size, flags, from, length);
    pthread_mutex_lock(&lock);
    if (size > reader->size) size = reader->size;
    memcpy(bytes, reader->bytes, size);
    reader->full = 0;
    pthread_mutex_unlock(&lock);
    return size;
}

ssize_t sendto(int fd, const void *bytes, size_t size, int flags, const struct sockaddr *to, socklen_t length) {
    if (control < 0 || !to || to->sa_family != AF_INET) return real_sendto(fd, bytes, size, flags, to, length);
    int port = ntohs(((const struct sockaddr_in *)to)->sin_port);
    if (port != MOTORS_PORT && port != RAW_PORT) return real_sendto(fd, bytes, size, flags, to, length);
    if (port == MOTORS_PORT && size >= MOTOR_BYTES) memcpy(motors, bytes, MOTOR_BYTES);
    return size;
}

int bind(int fd, const struct sockaddr *address, socklen_t length) {
    int kind = 0;
    socklen_t size = sizeof kind;
    if (control < 0 || getsockopt(fd, SOL_SOCKET, SO_TYPE, &kind, &size)) return real_bind(fd, address, length);
    if (kind == SOCK_DGRAM && address->sa_family == AF_INET) {
        int port = ntohs(((const struct sockaddr_in *)address)->sin_port);
        if (port == STATE_PORT) state.fd = fd;
        if (port == STICKS_PORT) sticks.fd = fd;
        return 0;
    }
    if (kind != SOCK_STREAM || address->sa_family != AF_INET) return real_bind(fd, address, length);
    /* A free port, which only this machine can reach. */
    static int announced;
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int failed = real_bind(fd, (struct sockaddr *)&here, sizeof here);
    size = sizeof here;
    if (!failed && !announced && !getsockname(fd, (struct sockaddr *)&here, &size)) {
        uint32_t port = ntohs(here.sin_port);
        announced = 1;
        put(&port, sizeof port);
    }
    return failed;
}
