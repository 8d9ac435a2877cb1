/* A class in C that changes what the whole process has: its locale, or its standard streams.
 *
 * Invariant: it does so once after each start, in the one entry its configuration names. */
#define _GNU_SOURCE
#include "trocar_plugin.h"

#include <locale.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

TROCAR_MANIFEST(
    "{\"trocar\":1,\"abi\":[1,2],\"name\":\"untidy\",\"version\":\"0.1.0\",\"panic\":\"none\",\"classes\":["
    "{\"name\":\"untidy\",\"execution\":{\"model\":\"periodic\",\"period_ns\":10000000},"
    "\"config\":{\"type\":\"object\",\"additionalProperties\":false,\"required\":[],\"properties\":{"
    "\"does\":{\"type\":\"string\",\"enum\":[\"nothing\",\"all\",\"numeric\",\"streams\"],\"default\":\"nothing\"},"
    "\"entry\":{\"type\":\"string\",\"enum\":[\"start\",\"step\",\"command\"],\"default\":\"start\"}}},"
    "\"provided\":[{\"name\":\"ctl\",\"commands\":["
    "{\"name\":\"poke\",\"kind\":\"void\",\"doc\":\"An entry to be untidy in\"},"
    "{\"name\":\"is_plain\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"The locale of the process is C\"},"
    "{\"name\":\"has_other\",\"kind\":\"void_return\",\"ret\":\"bool\",\"doc\":\"The machine has another locale\"}]}]}]}");

#define OTHER "C.UTF-8"

struct untidy {
    char json[256];
    int done;
};

static int says(const struct untidy *self, const char *word) { return strstr(self->json, word) != NULL; }

static void be_untidy(struct untidy *self, const char *entry) {
    if (self->done || !says(self, entry)) return;
    self->done = 1;
    if (says(self, "\"all\"")) setlocale(LC_ALL, OTHER);
    if (says(self, "\"numeric\"")) setlocale(LC_NUMERIC, OTHER);
    if (says(self, "\"streams\""))
        for (int fd = 0; fd <= 2; fd++) close(fd);
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

static trocar_status start(void *self, trocar_err *err) {
    (void)err;
    ((struct untidy *)self)->done = 0;
    be_untidy(self, "\"start\"");
    return TROCAR_STATUS_OK;
}

static trocar_status step(void *self, const trocar_tick *tick, trocar_err *err) {
    (void)tick, (void)err;
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
    if (id != 0 && ret != NULL) *(uint8_t *)ret = answer;
    return TROCAR_STATUS_OK;
}

static const trocar_class untidy = {
    .struct_size = sizeof untidy,
    .name = TROCAR_TEXT("untidy"),
    .create = create,
    .destroy = destroy,
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
