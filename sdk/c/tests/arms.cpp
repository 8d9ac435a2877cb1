// As many arms as are configured, in C++: a plugin whose repeated interfaces have commands, reads and
// handlers, and a little host that drives it through the tables. Exits with 0 when all is as it should be.
#include "trocar_plugin.hpp"

#include <cstdio>

TROCAR_MANIFEST(R"json({
"trocar":1,"abi":[1,2],"name":"cpp_arms","version":"0.1.0","panic":"none",
"types":[{"name":"ArmsState","size":32,"align":8,"fields":[{"name":"goal","at":0,"type":{"array":"f64","n":4},"unit":"rad"}]}],
"classes":[{"name":"cpp_arms","execution":{"model":"on_signal"},
 "config":{"type":"object","additionalProperties":false,"properties":{
  "arms":{"type":"array","items":{"type":"string"},"default":[],"live":true}},"required":[]},
 "provided":[{"name":"ctl","commands":[{"name":"home","kind":"void"}],"events":[]}],
 "state":{"ref":"ArmsState"}}]})json");

namespace {

struct State {
    double goal[4]; // rad
};

struct Arms : trocar::Component {
    std::vector<std::string> arms;
    State state = {};

    void configure(const trocar::Json &json) override {
        if (json["arms"].items().size() > 4) throw trocar::Refused("arms: there is room for 4");
        arms.clear();
        for (const trocar::Json &name : json["arms"].items()) arms.push_back(name.string());
    }
    std::string describe() override {
        std::string provided = R"({"name":"ctl","commands":[{"name":"home","kind":"void"}]})", required;
        for (const std::string &name : arms) {
            provided += R"(,{"name":"arm_)" + name + R"(","commands":[)"
                        R"({"name":"move","kind":"write_return","arg":{"type":"f64","unit":"rad"},"ret":"f64"},)"
                        R"({"name":"goal","kind":"read","ret":"f64"}]})";
            required += (required.empty() ? "" : ",") + std::string(R"({"name":"robot_)") + name +
                        R"(","optional":true,"handlers":[{"name":"moved","payload":"f64"}]})";
        }
        return R"({"types":[{"name":"ArmsState","size":32,"align":8,"fields":[)"
               R"({"name":"goal","at":0,"type":{"array":"f64","n":4},"unit":"rad"}]}],)"
               R"("class":{"name":"cpp_arms","execution":{"model":"on_signal"},"provided":[)" + provided +
               R"(],"required":[)" + required + R"(],"state":{"ref":"ArmsState"}}})";
    }
    void home() { state = {}; }
    double move(size_t arm, double goal) {
        state.goal[arm] = goal;
        return goal + 100.0 * static_cast<double>(arm);
    }
    void moved(size_t arm, double to) { state.goal[arm] = -to; }
    static double goal(const State &s, size_t arm) { return s.goal[arm]; }

    static void members(trocar::Members<Arms> &m) {
        m.command("ctl/home", &Arms::home);
        m.each_command("arm_{}/move", &Arms::move);
        m.each_read("arm_{}/goal", &Arms::goal);
        m.each_on("robot_{}/moved", &Arms::moved);
        m.state(&Arms::state);
    }
};

// Two kinds of repeated interfaces, only commands: they may come in any order.
struct Mixed : trocar::Component {
    std::string text;
    int left = 0, right = 0;

    std::string describe() override { return text; }
    int turn_left(size_t each) { return left = 10 + static_cast<int>(each); }
    int turn_right(size_t each) { return right = 20 + static_cast<int>(each); }
    static void members(trocar::Members<Mixed> &m) {
        m.each_command("left_{}/turn", &Mixed::turn_left);
        m.each_command("{}_right/turn", &Mixed::turn_right);
    }
};

// What does not fit: no {}, the same twice, and no describe that would name it.
struct Plain : trocar::Component {
    std::string describe() override { return std::string(); }
    void f(size_t) {}
    static void members(trocar::Members<Plain> &m) { m.each_command("ctl/f", &Plain::f); }
};
struct Twice : Plain {
    static void members(trocar::Members<Twice> &m) {
        m.each_command("a_{}/f", &Twice::g);
        m.each_command("a_{}/f", &Twice::g);
    }
    void g(size_t) {}
};
struct Silent : trocar::Component {
    void f(size_t) {}
    static void members(trocar::Members<Silent> &m) { m.each_command("a_{}/f", &Silent::f); }
};

int failures = 0;
void expect(bool good, const char *what) {
    if (!good) {
        std::printf("wrong: %s\n", what);
        ++failures;
    }
}

std::string logged;

trocar_host quiet_host() {
    trocar_host host = {};
    host.struct_size = sizeof host;
    host.log = [](void *, uint32_t, trocar_bytes, trocar_bytes text) { logged = std::string(trocar::text(text)); };
    return host;
}

const trocar_sink nowhere = {nullptr, [](void *, trocar_bytes) {}};

void the_present_arms_answer_each_for_itself(const trocar_class &c) {
    const trocar_host host = quiet_host();
    uint8_t room[128];
    trocar_err err = {room, sizeof room, 0};
    void *self = c.create(&host, trocar::bytes("a"), &err);
    expect(self != nullptr, "create");
    if (self == nullptr) return;
    const trocar_ports ports = {sizeof(trocar_ports), 0, 0, 0, 0, 0, nullptr, nullptr, nullptr, nullptr};
    double arg = 0.5, ret = 0.0;
    expect(c.command(self, 1, &arg, &ret, &err) == TROCAR_STATUS_UNSUPPORTED, "no arms yet");
    expect(c.configure(self, trocar::bytes(R"({"arms": ["left", "right"]})"), &err) == 0, "configure");
    expect(c.describe(self, &nowhere) == 0, "describe");
    expect(c.command(self, 1, &arg, &ret, &err) == TROCAR_STATUS_UNSUPPORTED, "not in force before bind");
    expect(c.bind(self, &ports, &err) == 0, "bind");
    // home; move and goal of left, of right.
    expect(c.command(self, 3, &arg, &ret, &err) == 0 && ret == 100.5, "the second arm");
    expect(c.command(self, 1, &arg, &ret, &err) == 0 && ret == 0.5, "the first arm");
    expect(c.command(self, 3, nullptr, &ret, &err) == TROCAR_STATUS_INVALID, "no argument");
    expect(c.command(self, 2, nullptr, &ret, &err) == TROCAR_STATUS_UNSUPPORTED, "a read is no command");
    expect(c.command(self, 5, &arg, &ret, &err) == TROCAR_STATUS_UNSUPPORTED, "no third arm");
    arg = 2.0;
    expect(c.on_event(self, 1, &arg, &err) == 0, "the second robot");
    expect(c.on_event(self, 2, &arg, &err) == TROCAR_STATUS_UNSUPPORTED, "no third robot");
    State row = {};
    c.state_copy(self, &row, sizeof row);
    expect(row.goal[0] == 0.5 && row.goal[1] == -2.0, "each its own goal");
    expect(c.read(&row, 2, nullptr, &ret, &err) == 0 && ret == 0.5, "goal of the first");
    expect(c.read(&row, 4, nullptr, &ret, &err) == 0 && ret == -2.0, "goal of the second");
    expect(c.read(&row, 3, nullptr, &ret, &err) == TROCAR_STATUS_UNSUPPORTED, "a command is no read");
    expect(c.command(self, 0, nullptr, nullptr, &err) == 0, "what is fixed stays where it was");
    c.destroy(self);
}

void names_are_looked_up_and_what_is_not_there_is_refused() {
    static const trocar::Json manifest = trocar::Json::parse(R"({"name": "mixed"})");
    const trocar_class &c = *trocar::Table<Mixed>::make(manifest, manifest["types"]);
    const trocar_host host = quiet_host();
    uint8_t room[256];
    trocar_err err = {room, sizeof room, 0};
    void *self = c.create(&host, trocar::bytes("m"), &err);
    expect(self != nullptr, "create mixed");
    if (self == nullptr) return;
    auto &mixed = *static_cast<Mixed *>(self);
    const trocar_ports ports = {sizeof(trocar_ports), 0, 0, 0, 0, 0, nullptr, nullptr, nullptr, nullptr};
    mixed.text = R"({"class": {"name": "mixed", "provided": [
        {"name": "left_a", "commands": [{"name": "turn", "ret": "i32"}]}, {"name": "x_right", "commands": [{"name": "turn", "ret": "i32"}]},
        {"name": "left_b", "commands": [{"name": "turn", "ret": "i32"}]}]}})";
    expect(c.describe(self, &nowhere) == 0 && c.bind(self, &ports, &err) == 0, "describe mixed");
    int ret = 0;
    const int wanted[] = {10, 20, 11};
    for (uint32_t id = 0; id < 3; ++id)
        expect(c.command(self, id, nullptr, &ret, &err) == 0 && ret == wanted[id], "which is meant");
    mixed.text = R"({"class": {"name": "mixed", "provided": [{"name": "left_a", "commands": [{"name": "jump"}]}]}})";
    expect(c.describe(self, &nowhere) == TROCAR_STATUS_FAILED && logged.find("left_a/jump") != std::string::npos &&
               logged.find("left_{}/turn, {}_right/turn") != std::string::npos, "a member nobody has");
    expect(c.command(self, 2, nullptr, &ret, &err) == 0 && ret == 11, "what was in force stays");
    mixed.text = R"({"class": {"name": "mixed", "provided": [{"name": "left_a", "commands": [
        {"name": "turn", "arg": {"type": "f64"}, "ret": "i32"}]}]}})";
    expect(c.describe(self, &nowhere) == TROCAR_STATUS_INVALID &&
               logged.find("left_{}/turn: the argument has 0 bytes in the code and 8 in the manifest") != std::string::npos,
           "a member of another size");
    expect(c.command(self, 2, nullptr, &ret, &err) == 0 && ret == 11, "what was in force stays");
    mixed.text = "{";
    expect(c.describe(self, &nowhere) == TROCAR_STATUS_INVALID, "no JSON");
    c.destroy(self);
    const auto refused = [&](const trocar_class *table, const char *what) {
        expect(table->create(&host, {}, &err) == nullptr &&
                   std::string(reinterpret_cast<const char *>(room), err.len).find(what) != std::string::npos, what);
    };
    refused(trocar::Table<Plain>::make(manifest, manifest["types"]), "ctl/f names no member of a repeated interface");
    refused(trocar::Table<Twice>::make(manifest, manifest["types"]), "a_{}/f is given twice");
    refused(trocar::Table<Silent>::make(manifest, manifest["types"]), "has no describe that names them");
}

} // namespace

TROCAR_PLUGIN(trocar::class_<Arms>("cpp_arms"))

int main() {
    const trocar_plugin *plugin = trocar_plugin_v1();
    expect(plugin != nullptr && plugin->class_count == 1, "the plugin has its class");
    if (plugin == nullptr) return 1;
    the_present_arms_answer_each_for_itself(*plugin->classes[0]);
    names_are_looked_up_and_what_is_not_there_is_refused();
    return failures == 0 ? 0 : 1;
}
