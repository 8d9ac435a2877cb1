//! A class beyond a limit does not compile, and the message says where and what to do.

#![allow(clippy::unwrap_used)]

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::*;
use crate::desc::{CommandDesc, ExecutionLimitsDesc, FieldDesc, ManyDesc, Prim, Safety};

static F64: TypeDesc = TypeDesc::prim(Prim::F64);
static FULL: TypeDesc = TypeDesc { size: 65_536, align: 8, kind: TypeKind::Array { item: &F64, n: 8192 } };
static LARGE: TypeDesc = TypeDesc { size: 80_000, align: 8, kind: TypeKind::Array { item: &F64, n: 10_000 } };
static READS: [ProvidedDesc; 1] = [ProvidedDesc {
    name: "ctl",
    doc: "",
    tag: "",
    commands: &[CommandDesc {
        name: "value",
        doc: "",
        kind: CommandKind::Read,
        arg: None,
        ret: None,
        ret_unit: "",
        ret_frame: "",
        overflow: "",
    }],
    events: &[],
}];

const fn input(ty: &'static TypeDesc) -> InputDesc {
    InputDesc {
        name: "image",
        doc: "",
        ty: PortType::Plain(ty),
        frame: "",
        tag: "",
        optional: false,
        fifo: 0,
    }
}
static TAKES_FULL: [InputDesc; 1] = [input(&FULL)];
static TAKES_LARGE: [InputDesc; 1] = [input(&LARGE)];
static TOO_MANY: [InputDesc; 10_001] = [const { input(&F64) }; 10_001];

const fn class() -> ClassDesc {
    ClassDesc {
        name: "cam",
        doc: "",
        safety: Safety::None,
        hardware: false,
        safe_from_any_thread: false,
        starts_programs: false,
        model: "on_signal",
        period_ns: 0,
        max_step_ns: 0,
        limits: ExecutionLimitsDesc::NONE,
        config: &[],
        inputs: &[],
        outputs: &[],
        required: &[],
        provided: &[],
        state: None,
        many: ManyDesc::NONE,
    }
}

fn said(check: impl FnOnce()) -> String {
    match catch_unwind(AssertUnwindSafe(check)) {
        Ok(()) => String::new(),
        Err(why) => why.downcast_ref::<String>().unwrap().clone(),
    }
}

#[test]
fn a_class_beyond_a_limit_is_refused_with_the_place_and_the_numbers() {
    let of = |class: ClassDesc| said(move || check_class(&class));
    assert_eq!(of(ClassDesc { inputs: &TAKES_FULL, state: Some(&FULL), ..class() }), "");
    assert_eq!(
        of(ClassDesc { inputs: &TAKES_LARGE, ..class() }),
        "input image: 80000 bytes are more than a value may have, 65536: send it through a port of frames, `Frame<Header>`"
    );
    let many = ManyDesc { inputs: &TAKES_LARGE, ..ManyDesc::NONE };
    assert!(of(ClassDesc { many, ..class() }).starts_with("input image: 80000 bytes"));
    assert!(of(ClassDesc { state: Some(&LARGE), ..class() }).starts_with("the #[state] fields: 80000 bytes"));
    assert_eq!(
        of(ClassDesc { inputs: &TOO_MANY, ..class() }),
        "a class has at most 10000 ports and members, this one 10001"
    );
    assert_eq!(
        of(ClassDesc { provided: &READS, ..class() }),
        "read ctl/value: a read returns a value, and this one returns nothing"
    );
}

#[test]
fn types_nested_too_deeply_and_endless_arrays_of_nothing_are_refused() {
    let leak = |kind| -> &'static TypeDesc { Box::leak(Box::new(TypeDesc { size: 8, align: 8, kind })) };
    let mut deep: &'static TypeDesc = &F64;
    for _ in 0..=MAX_DEPTH {
        deep = leak(TypeKind::Array { item: deep, n: 1 });
    }
    let why = said(|| check_class(&ClassDesc { state: Some(deep), ..class() }));
    assert!(why.ends_with("nested deeper than 32 arrays, lists and structs"), "{why}");
    let endless = leak(TypeKind::Array { item: &F64, n: 100_000 });
    let why = said(|| check_class(&ClassDesc { state: Some(endless), ..class() }));
    assert!(why.ends_with("100000 items are more than 65536"), "{why}");
}

#[test]
fn a_plugin_with_two_classes_of_one_name_or_an_odd_name_is_refused() {
    static CLASS: ClassDesc = class();
    static ONE: [&ClassDesc; 1] = [&CLASS];
    static TWICE: [&ClassDesc; 2] = [&CLASS, &CLASS];
    let of = |name, classes: &'static [&'static ClassDesc]| {
        let plugin = PluginDesc {
            name,
            version: "",
            vendor: "",
            license: "",
            doc: "",
            built_with: "",
            unload: false,
            classes,
        };
        said(move || check_plugin(&plugin))
    };
    assert_eq!(of("cams", &ONE), "");
    assert_eq!(
        of("cams", &TWICE),
        "two classes of this plugin are called `cam`: give one another name, #[component(name = \"…\")]"
    );
    assert_eq!(
        of("my cams", &ONE),
        "the name of the plugin, `my cams`, is not 1 to 63 letters, digits, `_` or `-`"
    );
}

#[test]
fn two_types_of_one_name_must_be_the_same_field_by_field() {
    const fn of(fields: &'static [FieldDesc]) -> TypeDesc {
        TypeDesc { size: 8, align: 8, kind: TypeKind::Struct { name: "Place", doc: "", fields } }
    }
    const fn field(unit: &'static str) -> FieldDesc {
        FieldDesc { name: "x", at: 0, ty: &F64, unit, doc: "", frame: "" }
    }
    static IN_METRES: [FieldDesc; 1] = [field("m")];
    static IN_NOTHING: [FieldDesc; 1] = [field("")];
    static METRES: TypeDesc = of(&IN_METRES);
    static OTHER_METRES: TypeDesc = of(&IN_METRES);
    static BARE: TypeDesc = of(&IN_NOTHING);
    let both = |inputs: &'static [InputDesc], state| {
        let mut types = crate::types::Types::NONE;
        said(move || types.add_class(&ClassDesc { inputs, state: Some(state), ..class() }))
    };
    static TAKES_METRES: [InputDesc; 1] = [input(&METRES)];
    assert_eq!(both(&TAKES_METRES, &OTHER_METRES), "");
    assert_eq!(
        both(&TAKES_METRES, &BARE),
        "two different payload types of this plugin are called `Place`: rename one"
    );
}

#[test]
fn a_name_that_no_path_could_have_is_refused_with_the_reason() {
    let long = "x".repeat(MAX_NAME + 1);
    for (name, why) in [
        ("", "use letters"),
        ("größe", "use letters"),
        ("a.b", "use letters"),
        ("2nd", "begins with a letter"),
        ("-a", "begins with a letter"),
        (long.as_str(), "it has 64 bytes, and at most 63 are allowed"),
    ] {
        assert!(name_fault(name).is_some_and(|said| said.contains(why)), "{name}: {:?}", name_fault(name));
    }
    for name in ["a", "_x", "my-filter_2", &long[1..]] {
        assert_eq!(name_fault(name), None);
    }
}
