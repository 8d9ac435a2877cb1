// Hands on poses, with types and structs of trocar_payloads.h alone.
#include "trocar_payloads.h"
#include "trocar_plugin.hpp"

TROCAR_MANIFEST(R"json({"trocar":1,"abi":[1,2],"name":"poses","version":"0.1.0","panic":"none",
"types":[)json" TROCAR_TYPE_POSE R"json(],
"classes":[{"name":"poses","execution":{"model":"on_signal"},
 "inputs":[{"name":"from","type":{"plain":{"ref":"Pose"}}}],
 "outputs":[{"name":"to","type":{"plain":{"ref":"Pose"}}}]}]})json");

struct Poses : trocar::Component {
    trocar::In<trocar::data::Pose> from;
    trocar::Out<trocar::data::Pose> to;

    void step(const trocar_tick &) override {
        trocar::data::Pose pose;
        if (from.fresh(pose)) to.write(pose, pose.stamp);
    }
    static void members(trocar::Members<Poses> &m) {
        m.input("from", &Poses::from);
        m.output("to", &Poses::to);
    }
};
TROCAR_PLUGIN(trocar::class_<Poses>("poses"))
