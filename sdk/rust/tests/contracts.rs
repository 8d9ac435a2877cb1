//! The contracts can be fulfilled with the payloads of the SDK, and their tables say of these what the
//! structs say.
#![allow(clippy::unwrap_used)]

use trocar_plugin_api::contracts::{CONTRACTS, PAYLOADS, leaves_of_payload};
use trocar_plugin_api::desc::{TypeDesc, TypeKind};
use trocar_plugin_api::manifest::Manifest;
use trocar_sdk::data::*;
use trocar_sdk::prelude::*;
use trocar_sdk::testing::{assert_implements, contracts, field_list};
use trocar_sdk::{crtk, data};

/// Name, documentation and field documentation of a struct.
fn docs(ty: &TypeDesc) -> (&'static str, &'static str, Vec<&'static str>) {
    match &ty.kind {
        TypeKind::Struct { name, doc, fields } => (name, doc, fields.iter().map(|f| f.doc).collect()),
        _ => panic!("a struct"),
    }
}

/// Gives the names of all structs of `trocar_sdk::data` to a macro.
macro_rules! all_payloads {
    ($to:ident) => {
        $to!(
            JointState,
            JointConfiguration,
            Pose,
            Twist,
            Wrench,
            CartesianState,
            ArmState,
            OperatingState,
            Transform,
            CameraGeometry,
            ImageHeader,
            StereoHeader,
            Spectrometer,
            SpectraHeader,
            AScanHeader,
            Distance,
            TrackedTools,
            ToolPose,
            ForceRange,
            InputState,
            InputLayout,
            ButtonEvent,
            Scalar,
            Message
        )
    };
}

#[test]
fn the_tables_describe_every_payload_field_by_field_as_the_structs_do() {
    macro_rules! compare {
        ($($ty:ident),*) => {$(
            let table = PAYLOADS.iter().find(|p| p.name == stringify!($ty)).unwrap();
            assert_eq!(leaves_of_payload(table.name, ""), field_list::<data::$ty>());
            let fields = table.fields.iter().map(|f| f.doc).collect();
            assert_eq!((table.name, one_line(table.doc).as_str(), fields), {
                let (name, doc, fields) = docs(data::$ty::DESC);
                (name, one_line(doc).leak() as &str, fields)
            });
        )*
        let compared = [$(stringify!($ty)),*];
        for p in PAYLOADS.iter().filter(|p| p.repr.is_empty()) {
            assert!(compared.contains(&p.name), "{} is in the tables and not compared here", p.name);
        }};
    }
    all_payloads!(compare);
}

/// A payload as an author in C reads it in `docs/INTERFACES.md`: its fields with their types, in the order of
/// the page.
struct Page {
    text: String,
}

impl Page {
    fn section(&self, name: &str) -> &str {
        let section =
            self.text.split(&format!("\n### `{name}`\n")).nth(1).unwrap_or_else(|| panic!("no {name}"));
        section.split("\n### ").next().unwrap()
    }

    fn fields(&self, name: &str) -> Vec<(&str, &str)> {
        let cells = |row: &'_ str| -> Option<(usize, usize, usize, usize)> {
            let ticks: Vec<usize> = row.match_indices('`').map(|(at, _)| at).take(4).collect();
            ticks.try_into().ok().map(|[a, b, c, d]: [usize; 4]| (a + 1, b, c + 1, d))
        };
        let rows = self.section(name).lines().filter(|line| line.starts_with("| `"));
        rows.map(|row| cells(row).map(|(a, b, c, d)| (&row[a..b], &row[c..d])).unwrap()).collect()
    }

    /// Bytes by the table of types in `docs/C_PLUGINS.md`.
    fn size(&self, ty: &str) -> usize {
        let inside = |head: &str| ty.strip_prefix(head)?.strip_suffix(']');
        let list = |inside: &str| {
            let (item, n) = inside.rsplit_once(';').unwrap();
            self.size(item) * n.parse::<usize>().unwrap()
        };
        match ty {
            "bool" | "u8" | "i8" => 1,
            "u16" | "i16" => 2,
            "u32" | "i32" | "f32" => 4,
            "u64" | "i64" | "f64" | "stamp" => 8,
            _ => match (inside("list["), inside("text["), inside("[")) {
                (Some(inside), ..) => 8 + list(inside),
                (_, Some(n), _) => 8 + n.parse::<usize>().unwrap(),
                (.., Some(inside)) => list(inside),
                _ => match self.section(ty).trim_start().lines().find_map(named_values) {
                    Some(repr) => self.size(repr),
                    None => self.fields(ty).iter().map(|(_, ty)| self.size(ty)).sum(),
                },
            },
        }
    }
}

/// The integer of a line such as "A u32: `OFF` = 0, `ON` = 1."
fn named_values(line: &str) -> Option<&str> {
    let (repr, values) = line.strip_prefix("A ")?.split_once(": `")?;
    values.contains("` = ").then_some(repr)
}

#[test]
fn the_page_lists_the_fields_of_payloads_where_they_lie_in_memory() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/INTERFACES.md");
    let page = Page { text: std::fs::read_to_string(path).unwrap() };
    let compare = |desc: &TypeDesc| {
        let TypeKind::Struct { name, fields, .. } = &desc.kind else { panic!("a struct") };
        let mut at = 0;
        let by_page: Vec<(&str, usize)> = page
            .fields(name)
            .into_iter()
            .map(|(field, ty)| {
                let begin = at;
                at += page.size(ty);
                (field, begin)
            })
            .collect();
        let in_memory: Vec<(&str, usize)> = fields.iter().map(|f| (f.name, f.at)).collect();
        assert_eq!((by_page, at), (in_memory, desc.size), "{name}");
    };
    let mut compared = 0;
    macro_rules! each {
        ($($ty:ident),*) => {$(
            compare(data::$ty::DESC);
            compared += 1;
        )*};
    }
    all_payloads!(each);
    assert_eq!(compared, PAYLOADS.iter().filter(|p| p.repr.is_empty()).count());
}

/// Line breaks of a doc comment are not part of it.
fn one_line(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn the_contract_of_arms_uses_crtk_names_with_crtk_payloads() {
    for interface in contracts::ARM.interfaces {
        for command in interface.commands {
            let name = crtk::name(command.name).unwrap_or_else(|| panic!("{} is no CRTK name", command.name));
            let carried = if command.ret.ty.is_empty() { command.arg.ty } else { command.ret.ty };
            let carried = match carried {
                "text[32]" => "Text",
                "bool" => "Flag",
                other => other,
            };
            assert_eq!(carried, name.payload, "{}", command.name);
            assert_eq!(command.kind == "read", name.used_as != crtk::Use::Command, "{}", command.name);
        }
    }
    let offered = |name: &str| contracts::ARM.interfaces[0].commands.iter().any(|c| c.name == name);
    for name in crtk::NAMES {
        assert!(offered(name.name), "the contract of arms says nothing of {}", name.name);
    }
    assert_eq!(crtk::name(crtk::SERVO_JP).unwrap().payload, "JointState");
}

#[derive(Component)]
#[component(model = "stream", safety = "sensor", provides("spectrometer"))]
struct Oct {
    #[output]
    spectra: Out<Frame<SpectraHeader>>,
    #[event("spectrometer")]
    overrun: Event<u64>,
    #[state]
    spectrometer: Spectrometer,
}
#[provides("spectrometer")]
impl Oct {
    #[read]
    fn spectrometer(s: &OctState) -> Spectrometer {
        s.spectrometer
    }
    #[command]
    fn trigger(&mut self) {
        self.overrun.emit(0);
        let _ = self.spectra.loan();
    }
}
impl Component for Oct {}

#[derive(Component)]
#[component(rate_hz = 60, safety = "sensor", provides("tracker"))]
struct Optical {
    #[output(name = "tools")]
    out: Out<TrackedTools>,
    #[event("tracker")]
    tool_lost: Event<Text<16>>,
    #[event("tracker")]
    tool_found: Event<Text<16>>,
    #[state]
    tools: TrackedTools,
}
#[provides("tracker")]
impl Optical {
    #[read]
    fn tools(s: &OpticalState) -> TrackedTools {
        s.tools
    }
    #[read]
    fn pose_of(s: &OpticalState, tool: Text<16>) -> Result<Pose, &'static str> {
        s.tools.pose(&tool).copied().ok_or("no such tool in view")
    }
}
impl Component for Optical {
    fn step(&mut self, _: &Tick) -> Result {
        self.out.write(&self.tools);
        self.tool_lost.emit("probe".into());
        self.tool_found.emit("probe".into());
        Ok(())
    }
}

#[derive(Component)]
#[component(rate_hz = 1000, safety = "sensor", provides("force_sensor"))]
struct Nano {
    #[output]
    wrench: Out<Wrench>,
    #[event("force_sensor")]
    overload: Event<Flag>,
    #[state]
    load: Wrench,
    #[state]
    limits: ForceRange,
}
#[provides("force_sensor")]
impl Nano {
    #[read]
    fn measured_cf(s: &NanoState) -> Wrench {
        s.load
    }
    #[read]
    fn range(s: &NanoState) -> ForceRange {
        s.limits
    }
    #[command]
    fn bias(&mut self) {
        self.wrench.write(&self.load);
        self.overload.emit(Flag::FALSE);
    }
}
impl Component for Nano {}

#[derive(Component)]
#[component(rate_hz = 100, safety = "sensor", provides("input"))]
struct Pedal {
    #[output]
    state: Out<InputState>,
    #[event("input")]
    button: Event<ButtonEvent>,
    #[state]
    now: InputState,
    #[state]
    names: InputLayout,
}
#[provides("input")]
impl Pedal {
    #[read]
    fn input_state(s: &PedalState) -> InputState {
        s.now
    }
    #[read]
    fn layout(s: &PedalState) -> InputLayout {
        s.names
    }
}
impl Component for Pedal {
    fn step(&mut self, _: &Tick) -> Result {
        self.state.write(&self.now);
        self.button.emit(ButtonEvent::default());
        Ok(())
    }
}

#[test]
fn each_contract_of_a_sensor_is_fulfilled_by_a_class_of_a_screen() {
    assert_implements::<Oct>(&contracts::SPECTROMETER);
    assert_implements::<Optical>(&contracts::TRACKER);
    assert_implements::<Nano>(&contracts::FORCE_SENSOR);
    assert_implements::<Pedal>(&contracts::INPUT);
}

#[test]
fn a_class_that_is_another_device_is_refused_with_everything_it_lacks() {
    let told = std::panic::catch_unwind(|| assert_implements::<Nano>(&contracts::CAMERA)).unwrap_err();
    let told = told.downcast_ref::<String>().unwrap();
    assert!(told.starts_with("class `nano` is no `camera` (docs/INTERFACES.md):"), "{told}");
    assert!(told.contains("provided interface `camera` is missing; there are force_sensor"), "{told}");
    assert!(told.contains("output `image` is missing"), "{told}");
}

#[test]
fn names_of_contracts_are_names() {
    for contract in CONTRACTS {
        assert!(contract.name.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{}", contract.name);
    }
}

#[test]
fn a_tool_out_of_view_has_no_pose_and_a_spectrometer_knows_its_ends() {
    let mut tools = TrackedTools::default();
    tools.tools.push(ToolPose { tool: "probe".into(), ..ToolPose::default() });
    assert!(tools.pose("probe").is_none(), "stamp 0 is not valid");
    tools.tools[0].pose.stamp = Stamp::from_ns(1);
    assert!(tools.pose("probe").is_some() && tools.pose("needle").is_none());
    let linear =
        Spectrometer { samples: 1025, wavelength: [840e-9, 50e-9, 0.0, 0.0], ..Spectrometer::default() };
    for (pixel, wavelength) in [(0, 790e-9), (512, 840e-9), (1024, 890e-9)] {
        assert!((linear.wavelength_of(pixel) - wavelength).abs() < 1e-18, "pixel {pixel}");
    }
}

#[test]
fn the_manifest_of_a_plugin_is_judged_as_its_class_is() {
    let plugin = trocar_sdk::static_plugin!(Oct, Nano);
    let manifest = Manifest::parse(plugin.manifest.as_bytes()).unwrap();
    assert_eq!(contracts::check(&manifest, "oct", &contracts::SPECTROMETER), []);
    assert_eq!(contracts::check(&manifest, "nano", &contracts::FORCE_SENSOR), []);
    assert!(!contracts::check(&manifest, "oct", &contracts::CAMERA).is_empty());
}
