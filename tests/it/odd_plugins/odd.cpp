// A plugin that breaks the contract where its configuration says, and whose words a terminal would obey.
//
// Invariant: without configuration it behaves; it changes the working directory whenever it is loaded, and
// stays there for many looks of a watchdog.
#include "trocar_plugin.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <unistd.h>

// JSON's own escapes: after the manifest is read these are the characters themselves.
#define LIE "\\u001b[2J\\u001b[31mgone\\nERROR host/other: it burns"

TROCAR_MANIFEST("{\"trocar\":1,\"abi\":[1,2],\"name\":\"odd\",\"version\":\"0.1.0\",\"license\":\"" LIE "\","
"\"doc\":\"plugin " LIE "\",\"built_with\":\"" LIE "\",\"panic\":\"none\","
R"json("types":[
 {"name":"Header","size":8,"align":8,"fields":[{"name":"stamp","at":0,"type":"stamp"}]},
 {"name":"OddState","size":8,"align":8,"fields":[{"name":"status","at":0,"type":"i64"}]}],
"classes":[{"name":"odd","safety":"actuator","execution":{"model":"periodic","period_ns":10000000},)json"
"\"doc\":\"class " LIE "\","
R"json("config":{"type":"object","additionalProperties":false,"required":[],"properties":{)json"
"\"in\":{\"type\":\"string\",\"description\":\"setting " LIE "\",\"default\":\"\"},"
R"json("status":{"type":"integer","description":"What the entry answers","minimum":-1000,"maximum":1000,"default":0},
 "lies":{"type":"boolean","description":"Its reason is one a terminal would obey","default":false},
 "keeps":{"type":"boolean","description":"Its handles stay in statics","default":false},
 "late":{"type":"boolean","description":"count uses what another one kept","default":false},
 "slots":{"type":"integer","description":"Frames reserved by start","minimum":0,"maximum":100000,"default":0}}},
"inputs":[],
"outputs":[{"name":"image","type":{"frame":{"ref":"Header"},"format":"image","max_bytes":0}}],
"required":[],
"provided":[{"name":"ctl","commands":[)json"
"{\"name\":\"poke\",\"kind\":\"void\",\"doc\":\"command " LIE "\"},"
R"json({"name":"count","kind":"void_return","ret":"i64","doc":"One"},
 {"name":"status","kind":"read","ret":"i64","doc":"What the entry answers"}],"events":[]}],
"state":{"ref":"OddState"}}]})json");

namespace {

__attribute__((constructor)) void wander() {
    if (chdir("/") != 0) abort();
    usleep(100000);
}

struct Odd {
    const trocar_host *host = nullptr;
    const trocar_out *image = nullptr;
    std::string in;
    long status = 0, slots = 0;
    bool lies = false, keeps = false, late = false;
};

// The slots of one of them, also when it is gone.
const trocar_host *kept_host = nullptr;
const trocar_out *kept_image = nullptr;

// Uses it from a thread that no component is known to have: 0 when each use was refused.
int64_t use_kept() {
    int64_t taken = 0;
    std::thread late([&taken] {
        for (int i = 0; i < 5; i++) {
            trocar_loan loan = {};
            loan.struct_size = sizeof loan;
            taken += kept_image->loan(kept_image->ctx, &loan) != TROCAR_UNBOUND;
            taken += kept_host->callback_enter(kept_host->ctx) != TROCAR_NOT_ACTIVE;
        }
    });
    late.join();
    return taken;
}

Odd &of(void *self) { return *static_cast<Odd *>(self); }

trocar_status say(trocar_err *err, trocar_status status, const std::string &why) {
    if (err != nullptr && err->ptr != nullptr) {
        err->len = std::min(why.size(), err->cap);
        std::memcpy(err->ptr, why.data(), err->len);
    }
    return status;
}

trocar_bytes bytes(const std::string &text) { return {reinterpret_cast<const uint8_t *>(text.data()), text.size()}; }

trocar_status in_entry(void *self, const char *entry, trocar_err *err) {
    Odd &c = of(self);
    if (c.in != entry) return TROCAR_STATUS_OK;
    const auto status = static_cast<trocar_status>(c.status);
    if (!c.lies) return status;
    const std::string lie = "\x1b[2J\x1b[31mgone\nERROR host/other: it burns";
    c.host->log(c.host->ctx, TROCAR_LOG_ERROR, bytes(lie), bytes(lie));
    return say(err, status, lie);
}

// What stands behind a key: the host has checked the JSON, which has no spaces that matter.
std::string value(const std::string &json, const char *key) {
    const size_t at = json.find("\"" + std::string(key) + "\"");
    if (at == std::string::npos) return "";
    const size_t begin = json.find_first_not_of(": \"", json.find(':', at));
    return json.substr(begin, json.find_first_of(",}\"", begin) - begin);
}

void *create(const trocar_host *host, trocar_bytes, trocar_err *) {
    Odd *self = new Odd;
    self->host = host;
    return self;
}
void destroy(void *self) { delete static_cast<Odd *>(self); }

trocar_status configure(void *self, trocar_bytes json, trocar_err *err) {
    const std::string text(reinterpret_cast<const char *>(json.ptr), json.len);
    Odd &c = of(self);
    c.in = value(text, "in");
    c.status = std::atol(value(text, "status").c_str());
    c.slots = std::atol(value(text, "slots").c_str());
    c.lies = value(text, "lies") == "true";
    c.keeps = value(text, "keeps") == "true";
    c.late = value(text, "late") == "true";
    return in_entry(self, "configure", err);
}

trocar_status bind(void *self, const trocar_ports *ports, trocar_err *) {
    of(self).image = ports->outputs[0];
    return TROCAR_STATUS_OK;
}

trocar_status start(void *self, trocar_err *err) {
    Odd &c = of(self);
    if (c.keeps) {
        kept_host = c.host;
        kept_image = c.image;
    }
    if (c.slots != 0) {
        const trocar_outcome outcome = c.image->reserve(c.image->ctx, 64, static_cast<uint32_t>(c.slots));
        if (outcome != TROCAR_EXECUTED) {
            return say(err, TROCAR_STATUS_FAILED, "reserve answered " + std::to_string(outcome));
        }
    }
    return in_entry(self, "start", err);
}

trocar_status stop(void *self, trocar_err *err) { return in_entry(self, "stop", err); }
trocar_status resume(void *self, trocar_err *err) { return in_entry(self, "resume", err); }
trocar_status make_safe(void *self, trocar_err *err) { return in_entry(self, "make_safe", err); }
trocar_status step(void *self, const trocar_tick *, trocar_err *err) { return in_entry(self, "step", err); }

trocar_status command(void *self, uint32_t, const void *, void *ret, trocar_err *err) {
    const int64_t answer = of(self).late ? use_kept() : 1;
    if (ret != nullptr) std::memcpy(ret, &answer, sizeof answer);
    return in_entry(self, "command", err);
}

// A read has no instance: the row holds what it is to answer.
trocar_status read(const void *row, uint32_t, const void *, void *ret, trocar_err *) {
    int64_t status = 0;
    std::memcpy(&status, row, sizeof status);
    if (ret != nullptr) std::memcpy(ret, row, sizeof status);
    return static_cast<trocar_status>(status);
}

void state_copy(void *self, void *dst, size_t len) {
    const int64_t status = of(self).in == "read" ? of(self).status : 0;
    std::memcpy(dst, &status, std::min(len, sizeof status));
}

trocar_class odd() {
    trocar_class table = {};
    table.struct_size = sizeof table;
    table.name = TROCAR_TEXT("odd");
    table.create = create;
    table.destroy = destroy;
    table.configure = configure;
    table.bind = bind;
    table.start = start;
    table.stop = stop;
    table.resume = resume;
    table.make_safe = make_safe;
    table.step = step;
    table.command = command;
    table.read = read;
    table.state_copy = state_copy;
    return table;
}

const trocar_class ODD = odd();
const trocar_class *const CLASSES[] = {&ODD};
const trocar_plugin PLUGIN = {
    sizeof(trocar_plugin), 0, TROCAR_ABI_MAJOR, TROCAR_ABI_MINOR, TROCAR_TEXT("odd"), TROCAR_TEXT("0.1.0"),
    nullptr, 1, 0, CLASSES,
};

} // namespace

TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { return &PLUGIN; }
