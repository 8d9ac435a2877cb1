/* The test of the component, without a host: ports of the test's own, and steps of 1 ms. */
#include "component.c"

#include <stdio.h>

static const trocar_scalar sent = {0, 3.0};
static trocar_scalar got;

static int to_come;

static int32_t next(void *ctx, trocar_sample *view) {
    (void)ctx;
    if (to_come-- <= 0) return TROCAR_IN_EMPTY;
    view->header = &sent;
    view->flags = TROCAR_SAMPLE_FRESH;
    return TROCAR_IN_SAMPLE;
}

static trocar_outcome write_value(void *ctx, const void *value, uint64_t stamp_ns) {
    (void)ctx, (void)stamp_ns;
    got = *(const trocar_scalar *)value;
    return TROCAR_EXECUTED;
}

static int expect(int holds, const char *what) {
    if (!holds) printf("wrong: %s\n", what);
    return !holds;
}

int main(void) {
    const trocar_in in = {.struct_size = sizeof in, .next = next};
    const trocar_out out = {.struct_size = sizeof out, .write = write_value};
    const trocar_in *const inputs[] = {&in};
    const trocar_out *const outputs[] = {&out};
    const trocar_ports ports = {
        .struct_size = sizeof ports, .input_count = 1, .output_count = 1, .inputs = inputs, .outputs = outputs,
    };
    const trocar_tick tick = {.struct_size = sizeof tick, .period_ns = 1000000, .elapsed_ns = 1000000};
    const trocar_class *c = trocar_plugin_v1()->classes[0];
    const double cutoff_hz = 20.0;
    void *self = c->create(NULL, (trocar_bytes){NULL, 0}, NULL);
    if (self == NULL) return 1;
    c->bind(self, &ports, NULL);
    c->start(self, NULL);
    c->command(self, SET_CUTOFF, &cutoff_hz, NULL, NULL);
    to_come = 1;
    c->step(self, &tick, NULL);
    int wrong = expect(got.value > 0.0 && got.value < 1.0, "the first value does not jump");
    /* Two samples in each step: none is lost. */
    for (int i = 0; i < 500; ++i) to_come = 2, c->step(self, &tick, NULL);
    wrong += expect(fabs(got.value - 3.0) < 1e-6, "a constant signal is reached in the end");
    double value = 1.0;
    trocar_scalar row;
    c->command(self, CLEAR, NULL, NULL, NULL);
    c->state_copy(self, &row, sizeof row);
    c->read(&row, VALUE, NULL, &value, NULL);
    wrong += expect(value == 0.0, "clear forgets the past");
    c->destroy(self);
    return wrong;
}
