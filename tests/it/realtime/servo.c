/* A class in C that says by which models and rates it is made to run.
 *
 * Invariant: it steps and does nothing else, so whatever is refused is refused for its manifest. */
#include "trocar_plugin.h"

TROCAR_MANIFEST("{\"trocar\":1,\"abi\":[1,2],\"name\":\"servo\",\"version\":\"0.1.0\",\"panic\":\"none\",\"classes\":["
                "{\"name\":\"servo\",\"doc\":\"Steps on a grid\",\"execution\":{\"model\":\"periodic\",\"period_ns\":5000000,"
                "\"models\":[\"periodic\",\"exec_in\"],\"min_period_ns\":1000000,\"max_period_ns\":20000000}}]}");

static int made;

static void *create(const trocar_host *host, trocar_bytes name, trocar_err *err) {
    (void)host, (void)name, (void)err;
    return &made;
}

static void destroy(void *self) { (void)self; }

static trocar_status step(void *self, const trocar_tick *tick, trocar_err *err) {
    (void)self, (void)tick, (void)err;
    return TROCAR_STATUS_OK;
}

static const trocar_class servo = {
    .struct_size = sizeof servo,
    .name = TROCAR_TEXT("servo"),
    .create = create,
    .destroy = destroy,
    .step = step,
};
static const trocar_class *const classes[] = {&servo};
static const trocar_plugin plugin = {
    .struct_size = sizeof plugin,
    .abi_major = TROCAR_ABI_MAJOR,
    .abi_minor = TROCAR_ABI_MINOR,
    .name = TROCAR_TEXT("servo"),
    .version = TROCAR_TEXT("0.1.0"),
    .class_count = 1,
    .classes = classes,
};

TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { return &plugin; }
