/* A class in C with thread-locals of ROOM bytes; with NEEDS, it calls a function of another library.
 *
 * Invariant: it does nothing, so whatever is refused is refused by the dynamic linker. */
#include "trocar_plugin.h"

TROCAR_MANIFEST("{\"trocar\":1,\"abi\":[1,2],\"name\":\"room\",\"version\":\"0.1.0\",\"panic\":\"none\",\"classes\":["
                "{\"name\":\"room\",\"execution\":{\"model\":\"none\"}}]}");

static __thread char room[ROOM];

#ifdef NEEDS
extern void from_elsewhere(void);
#else
static void from_elsewhere(void) {}
#endif

static int made;

static void *create(const trocar_host *host, trocar_bytes name, trocar_err *err) {
    (void)host, (void)name, (void)err;
    from_elsewhere();
    ((volatile char *)room)[ROOM - 1] = 1;
    return &made;
}

static void destroy(void *self) { (void)self; }

static const trocar_class class = {
    .struct_size = sizeof class,
    .name = TROCAR_TEXT("room"),
    .create = create,
    .destroy = destroy,
};
static const trocar_class *const classes[] = {&class};
static const trocar_plugin plugin = {
    .struct_size = sizeof plugin,
    .abi_major = TROCAR_ABI_MAJOR,
    .abi_minor = TROCAR_ABI_MINOR,
    .name = TROCAR_TEXT("room"),
    .version = TROCAR_TEXT("0.1.0"),
    .class_count = 1,
    .classes = classes,
};

TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { return &plugin; }
