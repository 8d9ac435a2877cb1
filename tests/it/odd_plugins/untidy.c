/* A class in C that changes what the whole process has: its locale, its standard streams, what signals do; or what
 * its thread has: how it calculates. Or it forks.
 *
 * Invariant: it does so once after each start, in the one entry its configuration names. */
#define _GNU_SOURCE
#include "trocar_plugin.h"

#include <errno.h>
#include <locale.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

TROCAR_MANIFEST(
    "{\"trocar\":1,\"abi\":[1,2],\"name\":\"untidy\",\"version\":\"0.1.0\",\"panic\":\"none\",\"classes\":["
    "{\"name\":\"untidy\",\"execution\":{\"model\":\"periodic\",\"period_ns\":10000000},"
    "\"config\":{\"type\":\"object\",\"additionalProperties\":false,\"required\":[],\"properties\":{"
    "\"does\":{\"type\":\"string\",\"enum\":[\"nothing\",\"all\",\"numeric\",\"streams\","
    "\"sigfpe\",\"sigpipe\",\"flush\",\"fork\",\"fork_exec\"],\"default\":\"nothing\"},"
    "\"entry\":{\"type\":\"string\",\"enum\":[\"start\",\"step\",\"command\"],\"default\":\"start\"}}},"
    "\"provided\":[{\"name\":\"ctl\",\"commands\":["
    "{\"name\":\"poke\",\"kind\":\"void\",\"doc\":\"An entry to be untidy in\"},"
    "{\"name\":\"is_plain\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"The locale of the process is C\"},"
    "{\"name\":\"has_other\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"The machine has another locale\"},"
    "{\"name\":\"is_told\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"A write to a closed pipe is told by its result\"},"
    "{\"name\":\"has_denormals\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"This thread calculates with them\"},"
    "{\"name\":\"stepped_without\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"A step met a thread without them\"},"
    "{\"name\":\"through\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"The other is poked, and this thread has denormals\"}]}],"
    "\"required\":[{\"name\":\"other\",\"optional\":true,\"functions\":[{\"name\":\"poke\"}]}]}]}");

#define OTHER "C.UTF-8"

/* Whether the smallest number survives a product, which it does not where a thread flushes such numbers to zero. */
static int has_denormals(void) {
    volatile double smallest = 4.9406564584124654e-324, one = 1.0;
    return smallest * one > 0.0;
}

static void flush_to_zero(void) {
#if defined(__x86_64__)
    _mm_setcsr(_mm_getcsr() | 0x8040);
#elif defined(__aarch64__)
    uint64_t word;
    __asm__ volatile("mrs %0, fpcr" : "=r"(word));
    __asm__ volatile("msr fpcr, %0" : : "r"(word | 1u << 24));
#endif
}

/* A child that stays, until somebody ends it or ten minutes have gone. */
static void leave_a_child(int runs_another_program) {
    if (fork() != 0) return;
    alarm(600);
    if (runs_another_program) execlp("sleep", "sleep", "600", (char *)NULL);
    for (;;) pause();
}

static void ignore(int signal) { (void)signal; }

struct untidy {
    char json[256];
    int done, stepped_without;
    const trocar_fn *other;
};

static int says(const struct untidy *self, const char *word) { return strstr(self->json, word) != NULL; }

static void be_untidy(struct untidy *self, const char *entry) {
    if (self->done || !says(self, entry)) return;
    self->done = 1;
    if (says(self, "\"all\"")) setlocale(LC_ALL, OTHER);
    if (says(self, "\"numeric\"")) setlocale(LC_NUMERIC, OTHER);
    if (says(self, "\"streams\""))
        for (int fd = 0; fd <= 2; fd++) close(fd);
    if (says(self, "\"sigfpe\"")) signal(SIGFPE, ignore);
    if (says(self, "\"sigpipe\"")) signal(SIGPIPE, SIG_DFL);
    if (says(self, "\"flush\"")) flush_to_zero();
    if (says(self, "\"fork\"")) leave_a_child(0);
    if (says(self, "\"fork_exec\"")) leave_a_child(1);
}

/* A write that nobody can read: told by its result, or, where SIGPIPE is not ignored, the end of the process. */
static int is_told(void) {
    int ends[2];
    if (pipe(ends) != 0) return 0;
    close(ends[0]);
    const ssize_t written = write(ends[1], "x", 1);
    const int why = errno;
    close(ends[1]);
    return written == -1 && why == EPIPE;
}

static void *create(const trocar_host *host, trocar_bytes name, trocar_err *err) {
    (void)host, (void)name, (void)err;
    return calloc(1, sizeof(struct untidy));
}

static void destroy(void *self) { free(self); }

static trocar_status configure(void *self, trocar_bytes json, trocar_err *err) {
    (void)err;
    struct untidy *c = self;
    if (json.len >= sizeof c->json) return TROCAR_STATUS_INVALID;
    memcpy(c->json, json.ptr, json.len);
    c->json[json.len] = 0;
    return TROCAR_STATUS_OK;
}

static trocar_status bind(void *self, const trocar_ports *ports, trocar_err *err) {
    (void)err;
    ((struct untidy *)self)->other = ports->functions[0];
    return TROCAR_STATUS_OK;
}

static trocar_status start(void *self, trocar_err *err) {
    (void)err;
    ((struct untidy *)self)->done = 0;
    ((struct untidy *)self)->stepped_without = 0;
    be_untidy(self, "\"start\"");
    return TROCAR_STATUS_OK;
}

static trocar_status step(void *self, const trocar_tick *tick, trocar_err *err) {
    (void)tick, (void)err;
    struct untidy *c = self;
    c->stepped_without |= !has_denormals();
    be_untidy(self, "\"step\"");
    return TROCAR_STATUS_OK;
}

static trocar_status command(void *self, uint32_t id, const void *arg, void *ret, trocar_err *err) {
    (void)arg, (void)err;
    uint8_t answer = 0;
    if (id == 0) be_untidy(self, "\"command\"");
    if (id == 1) answer = strcmp(setlocale(LC_ALL, NULL), "C") == 0;
    if (id == 2) {
        const locale_t other = newlocale(LC_ALL_MASK, OTHER, (locale_t)0);
        answer = other != (locale_t)0;
        if (answer) freelocale(other);
    }
    if (id == 3) answer = is_told();
    if (id == 4) answer = has_denormals();
    if (id == 5) answer = ((struct untidy *)self)->stepped_without;
    if (id == 6) {
        const trocar_fn *other = ((struct untidy *)self)->other;
        answer = other->call(other->ctx, NULL, NULL, NULL) == TROCAR_EXECUTED && has_denormals();
    }
    if (id != 0 && ret != NULL) *(uint8_t *)ret = answer;
    return TROCAR_STATUS_OK;
}

static const trocar_class untidy = {
    .struct_size = sizeof untidy,
    .name = TROCAR_TEXT("untidy"),
    .create = create,
    .destroy = destroy,
    .bind = bind,
    .configure = configure,
    .start = start,
    .step = step,
    .command = command,
};
static const trocar_class *const classes[] = {&untidy};
static const trocar_plugin plugin = {
    .struct_size = sizeof plugin,
    .abi_major = TROCAR_ABI_MAJOR,
    .abi_minor = TROCAR_ABI_MINOR,
    .name = TROCAR_TEXT("untidy"),
    .version = TROCAR_TEXT("0.1.0"),
    .class_count = 1,
    .classes = classes,
};

TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { return &plugin; }
