/* A first-order low-pass for a signal: change it into what you need.
 *
 * Manifest and table say the same: commands are numbered, and ports come, in the manifest's order. */
#include "trocar_payloads.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The host shows and checks this before a byte of the file runs; docs/C_PLUGINS.md of trocar has every key. */
TROCAR_MANIFEST(TROCAR_JSON({"trocar":1,"abi":[1,2],"name":"{{name}}","version":"0.1.0","panic":"none",
"types":[) TROCAR_TYPE_SCALAR TROCAR_JSON(],
"classes":[{"name":"{{crate}}","doc":"Smooths a signal.","execution":{"model":"periodic","period_ns":1000000},
 "inputs":[{"name":"raw","type":{"plain":{"ref":"Scalar"}},"fifo":16}],
 "outputs":[{"name":"filtered","type":{"plain":{"ref":"Scalar"}}}],
 "provided":[{"name":"control","commands":[
  {"name":"set_cutoff","doc":"Sets the -3 dB corner.","kind":"write",
   "arg":{"name":"cutoff","type":"f64","unit":"Hz","min":0.1,"max":400}},
  {"name":"clear","doc":"Forgets the past.","kind":"void"},
  {"name":"value","doc":"The latest output.","kind":"read","ret":"f64"}]}],
 "state":{"ref":"Scalar"}}]}));
enum { SET_CUTOFF, CLEAR, VALUE };

typedef struct {
    const trocar_in *raw;
    const trocar_out *filtered;
    trocar_scalar latest; /* Published after each step. */
    double cutoff_hz;
} component;

static void *create(const trocar_host *host, trocar_bytes name, trocar_err *err) {
    (void)host, (void)name, (void)err;
    component *self = calloc(1, sizeof *self);
    if (self != NULL) self->cutoff_hz = 10.0;
    return self;
}

static trocar_status bind(void *self, const trocar_ports *ports, trocar_err *err) {
    component *c = self;
    (void)err;
    c->raw = ports->inputs[0];
    c->filtered = ports->outputs[0];
    return TROCAR_STATUS_OK;
}

static trocar_status start(void *self, trocar_err *err) {
    (void)err;
    memset(&((component *)self)->latest, 0, sizeof(trocar_scalar));
    return TROCAR_STATUS_OK;
}

/* On the real-time path: no allocation, no lock, no waiting. */
static trocar_status step(void *self, const trocar_tick *tick, trocar_err *err) {
    component *c = self;
    trocar_sample view = {.struct_size = sizeof view};
    (void)err;
    /* Each sample once, also those of a moment in which this was late: the manifest asks for a "fifo". */
    while (c->raw->next(c->raw->ctx, &view) == TROCAR_IN_SAMPLE) {
        const trocar_scalar *x = view.header;
        /* By the samples' own times: a source may be slower than this component. */
        const int has_times = c->latest.stamp != 0 && x->stamp > c->latest.stamp;
        const double dt_s = (double)(has_times ? x->stamp - c->latest.stamp : tick->period_ns) * 1e-9;
        const double a = 1.0 - exp(-2.0 * 3.14159265358979323846 * c->cutoff_hz * dt_s);
        c->latest.stamp = x->stamp;
        c->latest.value += a * (x->value - c->latest.value);
        c->filtered->write(c->filtered->ctx, &c->latest, view.stamp_ns);
    }
    return TROCAR_STATUS_OK;
}

/* The host has checked the limits of the manifest. */
static trocar_status command(void *self, uint32_t id, const void *arg, void *ret, trocar_err *err) {
    (void)ret;
    if (id == SET_CUTOFF) ((component *)self)->cutoff_hz = *(const double *)arg;
    else if (id == CLEAR) return start(self, err);
    else return TROCAR_STATUS_UNSUPPORTED;
    return TROCAR_STATUS_OK;
}

/* Answered from the published state, on any thread. */
static trocar_status read(const void *row, uint32_t id, const void *arg, void *ret, trocar_err *err) {
    (void)arg, (void)err;
    if (id != VALUE) return TROCAR_STATUS_UNSUPPORTED;
    if (ret != NULL) memcpy(ret, &((const trocar_scalar *)row)->value, sizeof(double));
    return TROCAR_STATUS_OK;
}

static void state_copy(void *self, void *to, size_t len) { memcpy(to, &((component *)self)->latest, len); }

static const trocar_class CLASS = {
    .struct_size = sizeof CLASS, .name = TROCAR_TEXT("{{crate}}"), .create = create, .destroy = free, .bind = bind,
    .start = start, .step = step, .command = command, .read = read, .state_copy = state_copy,
};
static const trocar_class *const CLASSES[] = {&CLASS};
static const trocar_plugin PLUGIN = {
    .struct_size = sizeof PLUGIN, .abi_major = TROCAR_ABI_MAJOR, .abi_minor = TROCAR_ABI_MINOR,
    .name = TROCAR_TEXT("{{name}}"), .version = TROCAR_TEXT("0.1.0"), .class_count = 1, .classes = CLASSES,
};

TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { return &PLUGIN; }
