//! A manifest rendered at compile time reads back as what was described.

#![allow(clippy::unwrap_used)]

use crate::desc::*;
use crate::manifest::{Manifest, PortType as MPort, Type};

static F64: TypeDesc = TypeDesc::prim(Prim::F64);
static FORCE3: TypeDesc = TypeDesc { size: 24, align: 8, kind: TypeKind::Array { item: &F64, n: 3 } };
static FORCE: TypeDesc = TypeDesc {
    size: 24,
    align: 8,
    kind: TypeKind::Struct {
        name: "Force",
        doc: "A \"quoted\"\nforce",
        fields: &[FieldDesc { name: "f", at: 0, ty: &FORCE3, unit: "N", doc: "", frame: "" }],
    },
};
static CLASS: ClassDesc = ClassDesc {
    name: "low_pass",
    doc: "µ",
    safety: Safety::Sensor,
    hardware: false,
    safe_from_any_thread: false,
    starts_programs: false,
    model: "periodic",
    period_ns: 1_000_000,
    max_step_ns: 20_000_000,
    limits: ExecutionLimitsDesc {
        models: &["periodic", "exec_in"],
        min_period_ns: 100_000,
        max_period_ns: 10_000_000,
    },
    config: &[ConfigFieldDesc {
        name: "cutoff_hz",
        doc: "corner",
        schema: "\"type\":\"number\"",
        unit: "Hz",
        min: "0.1",
        max: "400.0",
        default: "50.0",
        live: true,
    }],
    inputs: &[InputDesc {
        name: "raw",
        doc: "",
        ty: PortType::Plain(&FORCE),
        frame: "",
        tag: "sim",
        optional: false,
        fifo: 0,
    }],
    outputs: &[OutputDesc {
        name: "out",
        doc: "",
        ty: PortType::Plain(&FORCE),
        frame: "retina",
        tag: "truth",
    }],
    required: &[RequiredDesc {
        name: "alarm",
        doc: "",
        optional: false,
        functions: &[],
        handlers: &[HandlerDesc {
            name: "rang",
            doc: "",
            payload: None,
            frame: "",
            optional: false,
            direct: true,
        }],
    }],
    provided: &[],
    state: Some(&FORCE),
    many: ManyDesc {
        inputs: &[InputDesc {
            name: "{}_f",
            doc: "",
            ty: PortType::Plain(&FORCE),
            frame: "",
            tag: "",
            optional: true,
            fifo: 4,
        }],
        ..ManyDesc::NONE
    },
};
static PLUGIN: PluginDesc = PluginDesc {
    name: "filters",
    version: "0.1.0",
    vendor: "",
    license: "",
    doc: "",
    built_with: "",
    unload: false,
    classes: &[&CLASS],
};
const LEN: usize = crate::render::<0>(&PLUGIN).1;
static TEXT: [u8; LEN] = crate::render::<LEN>(&PLUGIN).0;

#[test]
fn a_manifest_rendered_at_compile_time_parses_back_with_each_type_once() {
    let m = Manifest::parse(&TEXT).unwrap();
    assert_eq!(m.types.len(), 1);
    assert_eq!(m.types[0].doc, "A \"quoted\"\nforce");
    assert_eq!(m.classes[0].doc, "µ");
    let execution = &m.classes[0].execution;
    assert_eq!(execution.max_step_ns, 20_000_000);
    assert_eq!(execution.models, ["periodic", "exec_in"]);
    assert_eq!((execution.min_period_ns, execution.max_period_ns), (100_000, 10_000_000));
    assert!(m.classes[0].required[0].handlers[0].direct);
    assert_eq!(m.classes[0].inputs[0].ty, MPort::Plain { plain: Type::Ref { name: "Force".into() } });
    assert_eq!(
        (m.classes[0].outputs[0].frame.as_str(), m.classes[0].inputs[0].frame.as_str()),
        ("retina", "")
    );
    assert_eq!(m.classes[0].config["properties"]["cutoff_hz"]["maximum"], 400.0);
    assert_eq!(m.classes[0].config["properties"]["cutoff_hz"]["unit"], "Hz");
}

#[test]
fn the_description_of_a_class_has_its_fixed_part_and_what_is_to_be_repeated() {
    const LEN: usize = crate::render_description::<0>(&CLASS).1;
    static DESCRIPTION: [u8; LEN] = crate::render_description::<LEN>(&CLASS).0;
    let value: serde_json::Value = serde_json::from_slice(&DESCRIPTION).unwrap();
    assert_eq!(value["many"]["inputs"][0]["name"], "{}_f");
    let description: crate::manifest::Description = serde_json::from_value(value).unwrap();
    assert_eq!(description.class, Manifest::parse(&TEXT).unwrap().classes[0]);
    assert_eq!(description.types.len(), 1);
}
