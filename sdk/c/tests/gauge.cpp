// One of everything in C++, and a little host that drives it through the tables: exits with 0 when all is as
// it should be.
#include "trocar_plugin.hpp"

#include <cstdio>

TROCAR_MANIFEST(R"json({
"trocar":1,"abi":[1,2],"name":"cpp_gauge","version":"0.2.0","panic":"none",
"types":[{"name":"GaugeState","size":16,"align":8,"fields":[
 {"name":"sum","at":0,"type":"f64"},{"name":"count","at":8,"type":"u64"}]}],
"classes":[{"name":"gauge","doc":"\"adds\" \u00b5 up","execution":{"model":"periodic","period_ns":1000000},
 "inputs":[{"name":"x","type":{"plain":"f64"}}],"outputs":[{"name":"y","type":{"plain":"f64"}}],
 "required":[{"name":"peer","functions":[{"name":"ask","arg":"f64","ret":"f64"}],"handlers":[{"name":"rang","payload":"f64"}]}],
 "provided":[{"name":"ctl","commands":[
   {"name":"sum","kind":"read","ret":"f64"},{"name":"scaled","kind":"qualified_read","arg":{"type":"f64"},"ret":"f64"},
   {"name":"clear","kind":"void"},{"name":"add","kind":"write_return","arg":{"type":"f64"},"ret":"f64"},
   {"name":"fail","kind":"void"}],"events":[{"name":"over","payload":"f64"}]}],
 "state":{"ref":"GaugeState"}}]})json");

namespace {

struct State {
    double sum;
    uint64_t count;
};

struct Gauge : trocar::Component {
    trocar::In<double> x;
    trocar::Out<double> y;
    trocar::Function<double, double> ask;
    trocar::Event<double> over;
    State state = {};
    double limit = 10.0;

    void configure(const trocar::Json &json) override {
        const double given = json["limit"].number(10.0);
        if (given <= 0.0) throw trocar::Refused("limit: is not above 0");
        limit = given;
    }
    void step(const trocar_tick &tick) override {
        double value = 0.0;
        if (!x.fresh(value)) return;
        add(value);
        y.write(state.sum, tick.now_ns);
        double answer = 0.0;
        if (ask.call(value, answer) == TROCAR_EXECUTED) state.sum += answer;
    }
    double add(double value) {
        state.sum += value;
        state.count += 1;
        if (state.sum > limit) over.emit(state.sum);
        return state.sum;
    }
    void clear() { state = {}; }
    void fail() { throw std::out_of_range("no such thing"); }
    void rang(const double &value) { state.sum = -value; }
    static double sum(const State &s) { return s.sum; }
    static double scaled(const State &s, double by) { return s.sum * by; }

    static void members(trocar::Members<Gauge> &m) {
        m.input("x", &Gauge::x);
        m.output("y", &Gauge::y);
        m.function("peer/ask", &Gauge::ask);
        m.on("peer/rang", &Gauge::rang);
        m.event("ctl/over", &Gauge::over);
        m.command("ctl/add", &Gauge::add);
        m.command("ctl/clear", &Gauge::clear);
        m.command("ctl/fail", &Gauge::fail);
        m.read("ctl/sum", &Gauge::sum);
        m.read("ctl/scaled", &Gauge::scaled);
        m.state(&Gauge::state);
    }
};

// Turns frames over in place or into a loan, and has as many further inputs as it is told.
struct Header {
    uint64_t width;
};
struct Frames : trocar::Component {
    trocar::FrameIn<Header> in;
    trocar::FrameOut<Header> out;
    std::vector<const trocar_in *> more;
    int safe = 0;

    void configure(const trocar::Json &) override { out.reserve(16, 2); }
    void make_safe() override { ++safe; }
    void step(const trocar_tick &tick) override {
        while (in.next()) {
            if (in.header().width == 0) {
                out.forward(in, in.stamp());
            } else if (out.loan() == TROCAR_EXECUTED && out.capacity() >= in.size()) {
                out.header() = in.header();
                std::reverse_copy(in.bytes(), in.bytes() + in.size(), out.bytes());
                out.commit(in.size(), tick.now_ns);
            }
        }
    }
    std::string describe() override { return R"({"types":[],"class":{"name":"frames"}})"; }
    void bound(const trocar_ports &ports) override { more.assign(ports.inputs + 1, ports.inputs + ports.input_count); }
    std::string snapshot() override { return "kept"; }
    void restored(std::string_view kept) override { safe = kept == "kept" ? 100 : -100; }
    void answered(uint64_t token, const trocar::Json &reply) override {
        if (reply["ok"].boolean()) safe = static_cast<int>(token);
    }
    void grow() { ports_changed(); }

    static void members(trocar::Members<Frames> &m) {
        m.input("in", &Frames::in);
        m.output("out", &Frames::out);
        m.command("ctl/grow", &Frames::grow);
    }
};

// A member the manifest has not, and one it has that is missing.
struct Wrong : trocar::Component {
    trocar::In<double> z;
    static void members(trocar::Members<Wrong> &m) { m.input("z", &Wrong::z); }
};
struct Missing : trocar::Component {
    static void members(trocar::Members<Missing> &) {}
};

int failures = 0;
void expect(bool good, const char *what) {
    if (!good) {
        std::printf("wrong: %s\n", what);
        ++failures;
    }
}

double in_value = 3.0, out_value = 0.0, event_value = 0.0;

// What the host of the frames sees.
Header in_header = {3}, out_header = {0};
uint8_t in_bytes[] = {1, 2, 3}, out_bytes[16] = {};
int frames_left = 0, frames_lent = 0, forwarded = 0, wishes = 0;
uint64_t committed = 0, reserved_bytes = 0;
trocar_outcome lend = TROCAR_EXECUTED;

void frames_are_lent_forwarded_and_described() {
    static const trocar::Json manifest = trocar::Json::parse(
        R"({"name": "frames", "inputs": [{"name": "in", "type": {"frame": "u64"}}], "outputs": [{"name": "out", "type": {"frame": "u64"}}],
            "provided": [{"name": "ctl", "commands": [{"name": "grow"}]}]})");
    const trocar_class &c = *trocar::Table<Frames>::make(manifest, manifest["types"]);
    uint8_t room[128];
    trocar_err err = {room, sizeof room, 0};
    trocar_host host = {};
    host.struct_size = sizeof host;
    host.ports_changed = [](void *) -> trocar_outcome {
        ++wishes;
        return TROCAR_QUEUED;
    };
    void *self = c.create(&host, trocar::bytes("f"), &err);
    expect(self != nullptr, "create frames");
    if (self == nullptr) return;
    const auto &frames = *static_cast<const Frames *>(self);
    const trocar_tick tick = {sizeof(trocar_tick), 0, 0, 7, 7, 0, 0};
    expect(c.configure(self, trocar::bytes("{}"), &err) == 0 && c.step(self, &tick, &err) == 0, "unbound frames");

    trocar_in in = {}, second = {};
    in.next = [](void *, trocar_sample *v) -> int32_t {
        if (frames_left == 0) return TROCAR_IN_EMPTY;
        --frames_left;
        v->header = &in_header;
        v->bytes = in_bytes;
        v->len = sizeof in_bytes;
        return TROCAR_IN_SAMPLE;
    };
    trocar_out out = {};
    out.loan = [](void *, trocar_loan *loan) -> trocar_outcome {
        loan->header = &out_header;
        loan->bytes = out_bytes;
        loan->capacity = sizeof out_bytes;
        if (lend == TROCAR_EXECUTED) ++frames_lent;
        return lend;
    };
    out.commit = [](void *, trocar_loan *, uint64_t len, uint64_t) -> trocar_outcome {
        --frames_lent;
        committed = len;
        return TROCAR_EXECUTED;
    };
    out.cancel = [](void *, trocar_loan *) { --frames_lent; };
    out.forward = [](void *, const trocar_sample *, uint64_t) -> trocar_outcome {
        ++forwarded;
        return TROCAR_EXECUTED;
    };
    out.reserve = [](void *, uint64_t bytes, uint32_t) -> trocar_outcome {
        reserved_bytes = bytes;
        return TROCAR_EXECUTED;
    };
    const trocar_in *ins[] = {&in, &second};
    const trocar_out *outs[] = {&out};
    trocar_ports ports = {sizeof(trocar_ports), 1, 2, 0, 0, 0, outs, ins, nullptr, nullptr};
    expect(c.bind(self, &ports, &err) == 0 && frames.more.size() == 1 && frames.more[0] == &second, "a further input");
    expect(reserved_bytes == 16, "a pool asked for before is made at bind");
    ports.input_count = 0;
    expect(c.bind(self, &ports, &err) == TROCAR_STATUS_INVALID, "the manifest's inputs are always there");

    frames_left = 1;
    expect(c.step(self, &tick, &err) == 0 && committed == 3 && out_bytes[0] == 3 && out_header.width == 3, "a loan");
    frames_left = 1;
    lend = TROCAR_EXHAUSTED;
    committed = 0;
    expect(c.step(self, &tick, &err) == 0 && committed == 0, "no room, no frame");
    frames_left = 1;
    in_header.width = 0;
    expect(c.step(self, &tick, &err) == 0 && forwarded == 1 && frames_lent == 0, "forward");

    std::string told;
    const trocar_sink sink = {&told, [](void *ctx, trocar_bytes b) { static_cast<std::string *>(ctx)->append(trocar::text(b)); }};
    expect(c.describe != nullptr && c.describe(self, &sink) == 0 && told.find("\"frames\"") != std::string::npos, "describe");
    expect(c.command(self, 0, nullptr, nullptr, &err) == 0 && wishes == 1, "ports_changed");
    expect(c.make_safe(self, &err) == 0 && frames.safe == 1, "make_safe");
    expect(c.on_service(self, 9, trocar::bytes(R"({"ok": true})")) == 0 && frames.safe == 9, "a reply");
    told.clear();
    expect(c.snapshot(self, &sink) == 0 && told == "kept", "snapshot");
    expect(c.restore(self, {nullptr, 0}, trocar::bytes(told), &err) == 0 && frames.safe == 100, "restored");
    c.destroy(self);
}

} // namespace

TROCAR_PLUGIN(trocar::class_<Gauge>("gauge"))

static_assert(trocar::image_fits(14, 2, 2, 8, 3) && !trocar::image_fits(13, 2, 2, 8, 3), "the last row has no gap");
static_assert(!trocar::image_fits(99, 2, 2, 5, 3) && !trocar::image_fits(99, 0, 2, 5, 3), "rows lie apart, and have pixels");
static_assert(!trocar::image_fits(99, 65536, 65536, 65536, 1), "a product beyond 32 bits");
static_assert(!trocar::image_fits(99, UINT32_MAX, UINT32_MAX, UINT32_MAX, UINT32_MAX), "nor beyond 64");
static_assert(!trocar::image_fits(UINT64_MAX / 2, 1, UINT32_MAX, UINT32_MAX, 1, 9), "all of it counts");
static_assert(trocar::image_fits(8, 2, 2, 2, 1, 4) && !trocar::image_fits(8, 2, 2, 2, 1, 5), "the right image");
static_assert(!trocar::image_fits(8, 2, 2, 2, 1, UINT64_MAX), "an offset beyond all bytes");

void values() {
    trocar::Text<16> text = {};
    expect(text.set("0123456789abcdef") && text.set("abc") && text.view() == "abc", "a text is what was set last");
    expect(text.room[3] == 0 && text.room[15] == 0, "behind a text all is zero");
    expect(!text.set("0123456789abcdefg") && text.view() == "abc", "a text that is too long changes nothing");
    trocar::List<double, 2> list = {};
    expect(list.push(1.0) && list.push(2.0) && !list.push(3.0) && list.size() == 2 && list[1] == 2.0, "a list has its room");
    list.clear();
    expect(list.size() == 0 && list.room[1] == 0.0, "behind a list all is zero");
    expect(trocar::seconds_after(1500000000, 1000000000) == 0.5, "the time between two samples");
    for (const uint64_t later : {uint64_t{0}, uint64_t{6}, uint64_t{7}})
        expect(!trocar::seconds_after(later, 7), "an earlier stamp, or the same, tells no time between samples");
    expect(!trocar::seconds_after(7, 0), "the first sample has none before it");
}

int main() {
    values();
    const trocar_plugin *plugin = trocar_plugin_v1();
    expect(plugin != nullptr && plugin->class_count == 1, "the plugin has its class");
    if (plugin == nullptr) return 1;
    expect(trocar::text(plugin->name) == "cpp_gauge" && trocar::text(plugin->version) == "0.2.0", "name, version");
    const trocar_class &c = *plugin->classes[0];
    uint8_t room[128];
    trocar_err err = {room, sizeof room, 0};
    auto said = [&] { return std::string(reinterpret_cast<const char *>(room), err.len); };

    trocar_host host = {};
    host.struct_size = sizeof host;
    void *self = c.create(&host, trocar::bytes("g"), &err);
    expect(self != nullptr, "create");
    if (self == nullptr) return 1;
    const trocar_tick tick = {sizeof(trocar_tick), 0, 0, 1, 1, 0, 0};
    expect(c.step(self, &tick, &err) == TROCAR_STATUS_OK, "unbound ports do nothing");

    trocar_in in = {};
    in.latest = [](void *, trocar_sample *v) -> int32_t {
        v->header = &in_value;
        v->flags = TROCAR_SAMPLE_FRESH;
        return TROCAR_IN_SAMPLE;
    };
    trocar_out out = {};
    out.write = [](void *, const void *v, uint64_t) -> trocar_outcome {
        std::memcpy(&out_value, v, sizeof out_value);
        return TROCAR_EXECUTED;
    };
    trocar_fn fn = {};
    fn.call = [](void *, const void *arg, void *ret, trocar_call_opts *) -> trocar_outcome {
        const double twice = 2.0 * *static_cast<const double *>(arg);
        std::memcpy(ret, &twice, sizeof twice);
        return TROCAR_EXECUTED;
    };
    trocar_event event = {};
    event.emit = [](void *, const void *p) -> trocar_outcome {
        std::memcpy(&event_value, p, sizeof event_value);
        return TROCAR_EXECUTED;
    };
    const trocar_in *ins[] = {&in};
    const trocar_out *outs[] = {&out};
    const trocar_fn *fns[] = {&fn};
    const trocar_event *events[] = {&event};
    trocar_ports ports = {sizeof(trocar_ports), 1, 1, 1, 1, 0, outs, ins, fns, events};
    expect(c.bind(self, &ports, &err) == TROCAR_STATUS_OK, "bind");
    ports.input_count = 2;
    expect(c.bind(self, &ports, &err) == TROCAR_STATUS_INVALID && said().find("counts") != std::string::npos, "bad bind");

    expect(c.configure(self, trocar::bytes(R"({"limit": 8.5e0, "s": "\u00b5\n", "l": [1, true, null, {}]})"), &err) == 0,
           "configure");
    expect(c.configure(self, trocar::bytes(R"({"limit": -1})"), &err) == TROCAR_STATUS_INVALID &&
               said() == "limit: is not above 0", "a refusal has its sentence");
    for (const char *bad : {"{", "[1,", "{\"a\" 1}", "nul", "1 2", "\"\\x\"", "--", "{\"a\":1,}"})
        expect(c.configure(self, trocar::bytes(bad), &err) == TROCAR_STATUS_INVALID, bad);
    expect(c.configure(self, trocar::bytes(std::string(5000, '[')), &err) == TROCAR_STATUS_INVALID, "deep JSON");

    expect(c.configure(self, trocar::bytes(R"({"limit": 2})"), &err) == 0, "configure again");
    expect(c.step(self, &tick, &err) == TROCAR_STATUS_OK && out_value == 3.0 && event_value == 3.0, "step");
    State row = {};
    c.state_copy(self, &row, sizeof row);
    expect(row.sum == 9.0 && row.count == 1, "the answer was added");

    double arg = 1.5, ret = 0.0;
    expect(c.command(self, 3, &arg, &ret, &err) == TROCAR_STATUS_OK && ret == 10.5, "write-return");
    expect(c.command(self, 3, nullptr, &ret, &err) == TROCAR_STATUS_INVALID, "no argument");
    expect(c.read(&row, 0, nullptr, &ret, &err) == TROCAR_STATUS_OK && ret == 9.0, "read");
    expect(c.read(&row, 1, &arg, &ret, &err) == TROCAR_STATUS_OK && ret == 13.5, "qualified read");
    expect(c.read(&row, 2, nullptr, &ret, &err) == TROCAR_STATUS_UNSUPPORTED, "a command is no read");
    expect(c.command(self, 99, nullptr, nullptr, &err) == TROCAR_STATUS_UNSUPPORTED, "unknown id");
    expect(c.command(self, 4, nullptr, nullptr, &err) == TROCAR_STATUS_PANICKED && said() == "no such thing", "exception");
    expect(c.on_event(self, 0, &arg, &err) == TROCAR_STATUS_OK, "handler");
    expect(c.restore(self, {reinterpret_cast<const uint8_t *>(&row), sizeof row}, {nullptr, 0}, &err) == 0, "restore");
    expect(c.restore(self, {reinterpret_cast<const uint8_t *>(&row), 3}, {nullptr, 0}, &err) < 0, "bad restore");
    expect(c.describe == nullptr, "a class whose ports stay has no describe");
    expect(c.command(self, 2, nullptr, nullptr, &err) == TROCAR_STATUS_OK, "void");
    c.state_copy(self, &row, sizeof row);
    expect(row.sum == 0.0, "cleared");
    c.destroy(self);

    static const trocar::Json manifest = trocar::Json::parse(R"({"name": "w", "inputs": [{"name": "x"}]})");
    expect(trocar::Table<Wrong>::make(manifest, manifest["types"])->create(&host, {}, &err) == nullptr &&
               said().find("no z among the inputs") != std::string::npos, "a member the manifest has not");
    expect(trocar::Table<Missing>::make(manifest, manifest["types"])->create(&host, {}, &err) == nullptr &&
               said().find("nothing is given for inputs") != std::string::npos, "a member that is missing");
    frames_are_lent_forwarded_and_described();
    return failures == 0 ? 0 : 1;
}
