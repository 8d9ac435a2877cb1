// The test of the component, without a host: ports of the test's own, and steps of 1 ms.
#include "component.cpp"

#include <cstdio>

static Scalar sent = {0, 3.0};
static Scalar got = {};

static int to_come = 0;

static int32_t next(void *, trocar_sample *view) {
    if (to_come-- <= 0) return TROCAR_IN_EMPTY;
    view->header = &sent;
    view->flags = TROCAR_SAMPLE_FRESH;
    return TROCAR_IN_SAMPLE;
}

static trocar_outcome write(void *, const void *value, uint64_t) {
    got = *static_cast<const Scalar *>(value);
    return TROCAR_EXECUTED;
}

static int expect(bool holds, const char *what) {
    if (!holds) std::printf("wrong: %s\n", what);
    return holds ? 0 : 1;
}

int main() {
    trocar_in in = {};
    in.next = next;
    trocar_out out = {};
    out.write = write;
    {{Name}} component;
    component.raw.tie(&in);
    component.filtered.tie(&out);
    component.configure(trocar::Json::parse(R"({"cutoff_hz": 20})"));
    component.start();
    const trocar_tick tick = {sizeof tick, 0, 0, 0, 0, 1000000, 1000000};
    to_come = 1;
    component.step(tick);
    int wrong = expect(got.value > 0.0 && got.value < 1.0, "the first value does not jump");
    // Two samples in each step: none is lost.
    for (int i = 0; i < 500; ++i) to_come = 2, component.step(tick);
    wrong += expect(std::fabs(got.value - 3.0) < 1e-6, "a constant signal is reached in the end");
    component.clear();
    wrong += expect({{Name}}::value(component.latest) == 0.0, "clear forgets the past");
    return wrong;
}
