// A first-order low-pass for a signal: change it into what you need.
//
// Names in `members` are looked up in the manifest and sizes compared, so that the two cannot drift apart.
#include "trocar_payloads.h"
#include "trocar_plugin.hpp"

#include <cmath>

using trocar::data::Scalar;

// The host shows and checks this before a byte of the file runs; docs/C_PLUGINS.md of trocar has every key.
TROCAR_MANIFEST(R"json({"trocar":1,"abi":[1,2],"name":"{{name}}","version":"0.1.0","panic":"none",
"types":[)json" TROCAR_TYPE_SCALAR R"json(],
"classes":[{"name":"{{crate}}","doc":"Smooths a signal.","execution":{"model":"periodic","period_ns":1000000},
 "config":{"type":"object","additionalProperties":false,"properties":{
  "cutoff_hz":{"type":"number","description":"-3 dB corner of the filter","unit":"Hz",
   "minimum":0.1,"maximum":400,"default":10,"live":true}}},
 "inputs":[{"name":"raw","type":{"plain":{"ref":"Scalar"}},"fifo":16}],
 "outputs":[{"name":"filtered","type":{"plain":{"ref":"Scalar"}}}],
 "provided":[{"name":"control","commands":[
  {"name":"clear","doc":"Forgets the past.","kind":"void"},
  {"name":"value","doc":"The latest output.","kind":"read","ret":"f64"}]}],
 "state":{"ref":"Scalar"}}]})json");

struct {{Name}} : trocar::Component {
    trocar::In<Scalar> raw;
    trocar::Out<Scalar> filtered;
    Scalar latest = {}; // Published after each step.
    double cutoff_hz = 10.0;

    // The host has checked the settings against the manifest.
    void configure(const trocar::Json &json) override { cutoff_hz = json["cutoff_hz"].number(10.0); }

    void start() override { latest = {}; }

    // On the real-time path: no allocation, no lock, no waiting.
    void step(const trocar_tick &tick) override {
        const double period_s = static_cast<double>(tick.period_ns) * 1e-9;
        // Each sample once, also those of a moment in which this was late: the manifest asks for a "fifo".
        for (Scalar x; raw.next(x);) {
            // By the samples' own times: a source may be slower than this component.
            const double dt_s = trocar::seconds_after(x.stamp, latest.stamp).value_or(period_s);
            const double a = 1.0 - std::exp(-2.0 * 3.14159265358979323846 * cutoff_hz * dt_s);
            latest.stamp = x.stamp;
            latest.value += a * (x.value - latest.value);
            filtered.write(latest, raw.stamp());
        }
    }

    void clear() { latest = {}; }
    static double value(const Scalar &latest) { return latest.value; }

    static void members(trocar::Members<{{Name}}> &m) {
        m.input("raw", &{{Name}}::raw);
        m.output("filtered", &{{Name}}::filtered);
        m.command("control/clear", &{{Name}}::clear);
        m.read("control/value", &{{Name}}::value);
        m.state(&{{Name}}::latest);
    }
};
TROCAR_PLUGIN(trocar::class_<{{Name}}>("{{crate}}"))
