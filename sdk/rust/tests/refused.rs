//! Classes that no host would list do not compile, and the compiler says why at the author's own words: each
//! case is compiled by cargo. Refusals that the tokens alone give away are in `sdk/derive/src/refused.rs`.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;
use trocar_sdk::serde_json::Value;

/// Name, source, the compiler's message, and the source text it points at.
const CASES: &[(&str, &str, &str, &str)] = &[
    (
        "rate_of_a_signal",
        r#"#[derive(Component)] #[component(model = "on_signal", rate_hz = 4)] struct Cam {}
        impl Component for Cam {}"#,
        "a rate means nothing to model on_signal, it steps when something arrives",
        "rate_hz",
    ),
    (
        "large_input",
        "#[derive(Component)] struct Cam { #[input] image: In<[f64; 10_000]> }
        impl Component for Cam {}",
        "input image: 80000 bytes are more than a value may have, 65536: send it through a port of frames",
        "Cam",
    ),
    (
        "large_argument",
        r#"#[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[command] fn set(&mut self, all: [f64; 10_000]) {} }
        impl Component for Cam {}"#,
        "command ctl/set: 80000 bytes are more",
        "Cam",
    ),
    (
        "large_state",
        "#[derive(Component)] struct Cam { #[state] a: [f64; 8000], #[state] b: [f64; 8000] }
        impl Component for Cam {}",
        "the #[state] fields: 128000 bytes are more",
        "Cam",
    ),
    (
        "read_of_nothing",
        r#"#[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[read] fn look(s: &CamState) -> Result<(), String> { Ok(()) } }
        impl Component for Cam {}"#,
        "read ctl/look: a read returns a value, and this one returns nothing",
        "Cam",
    ),
    (
        "text_as_an_argument",
        r#"#[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[command] fn say(&mut self, text: String) {} }
        impl Component for Cam {}"#,
        "`std::string::String` is no payload: a command, function or event cannot carry it",
        "String",
    ),
    (
        "aligned_payload",
        "#[derive(Payload, Clone, Copy)] #[repr(C, align(16))] struct Vector { v: [f64; 2] }",
        "`Vector` is aligned to more than 8 bytes",
        "Vector",
    ),
    (
        "format_of_a_number",
        r#"#[derive(Component)] struct Cam { #[input(format = "image")] image: In<f64> }
        impl Component for Cam {}"#,
        "format and max_bytes are settings of a port of frames",
        "",
    ),
    (
        "limits_of_a_flag",
        r#"#[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[command] fn light(&mut self, #[arg(min = 0)] on: Flag) {} }
        impl Component for Cam {}"#,
        "min and max are limits of numbers, and this argument has none",
        "min",
    ),
    (
        "limits_of_a_text",
        r#"#[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[command] fn say(&mut self, #[arg(max = 80)] what: Text<80>) {} }
        impl Component for Cam {}"#,
        "named values are no numbers): remove min and max, or take a number",
        "max",
    ),
    (
        "limits_of_a_struct_without_numbers",
        r#"#[derive(Payload, Clone, Copy)] #[repr(C)] struct Switch { at: Stamp, on: [Flag; 8] }
        #[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[command] fn set(&mut self, #[arg(max = 3)] all: &List<Switch, 2>) {} }
        impl Component for Cam {}"#,
        "min and max are limits of numbers, and this argument has none",
        "max",
    ),
    (
        "limits_of_named_values",
        r#"named_values! { pub struct Mode: u8 { OFF = 0, ON = 1 } }
        #[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[read] fn look(s: &CamState, #[arg(min = 0, max = 1)] mode: Mode) -> f64 { 0.0 } }
        impl Component for Cam {}"#,
        "min and max are limits of numbers, and this argument has none",
        "max",
    ),
    (
        "unit_of_a_flag",
        r#"#[derive(Component)] #[component(provides("ctl"))] struct Cam {}
        #[provides("ctl")] impl Cam { #[command] fn light(&mut self, #[arg(unit = "mm")] on: Flag) {} }
        impl Component for Cam {}"#,
        "a unit is one of numbers, and this argument has none",
        "unit",
    ),
    (
        "limits_of_a_setting_that_is_a_text",
        r#"#[derive(Config)] struct Cfg { #[config(live, min = 0, default = "x")] label: String }"#,
        "min and max are for numbers, not for String: remove them, or take a number",
        "",
    ),
    (
        "unit_of_a_setting_that_is_a_flag",
        r#"#[derive(Config)] struct Cfg { #[config(unit = "Hz", default = true)] fast: bool }"#,
        "a unit is for numbers, not for bool: remove it, or take a number",
        "",
    ),
    (
        "limits_of_what_a_handler_is_given",
        r#"#[derive(Component)] struct Cam {}
        #[handles("robot")] impl Cam { #[on] fn moved(&mut self, #[arg(max = 3)] to: f64) {} }
        impl Component for Cam {}"#,
        "limits are for the arguments of commands; remove #[arg(…)]",
        "max",
    ),
    (
        "two_classes_of_one_name",
        r#"#[derive(Component)] struct Cam {}
        impl Component for Cam {}
        #[derive(Component)] #[component(name = "cam")] struct Other {}
        impl Component for Other {}
        trocar_plugin!(Cam, Other);"#,
        "two classes of this plugin are called `cam`",
        "",
    ),
    (
        "two_types_of_one_name",
        r#"mod metres {
            #[derive(trocar_sdk::Payload, Clone, Copy)] #[repr(C)] pub struct Place { #[unit("m")] x: f64 }
        }
        #[derive(Payload, Clone, Copy)] #[repr(C)] struct Place { x: f64 }
        #[derive(Component)] struct Cam { #[input] a: In<Place>, #[input] b: In<metres::Place> }
        impl Component for Cam {}
        trocar_plugin!(Cam);"#,
        "two different payload types of this plugin are called `Place`: rename one",
        "",
    ),
    (
        "odd_plugin_name",
        r#"#[derive(Component)] struct Cam {}
        impl Component for Cam {}
        const CAMS: trocar_sdk::StaticPlugin = trocar_sdk::static_plugin!(name = "my cams", Cam);"#,
        "the name of the plugin, `my cams`, is not 1 to 63 letters",
        "",
    ),
];

/// The one that compiles; its limits hold for numbers inside of a list.
const CONTROL: &str = r#"#[derive(Payload, Clone, Copy)] #[repr(C)] struct Goal { at: Stamp, x: [f64; 3] }
    #[derive(Component)] #[component(provides("ctl"))] struct Cam {}
    #[provides("ctl")] impl Cam {
        #[command] fn go(&mut self, #[arg(unit = "mm", min = 0, max = 9)] all: &List<Goal, 2>) {}
        #[command] fn wait(&mut self, #[arg(unit = "ns")] until: Stamp) {}
    }
    impl Component for Cam {}"#;

/// More cases, where one mistake is one error: the author sees no error that follows from code that is
/// missing.
const ALONE: &[(&str, &str, &str)] = &[
    (
        "unit_under_an_event",
        r#"#[derive(Component)] struct Scaler {
            #[input] x: In<f64>, #[required(interface = "robot")] hold: Function<f64>,
            #[event("ctl")] #[unit("N")] large: Event<f64>, #[state] y: f64, #[state] n: u64,
        }
        #[provides("ctl")] impl Scaler {
            #[command] fn clear(&mut self) { self.y = 0.0; self.large.emit(self.y); }
            #[read] fn value(s: &ScalerState) -> f64 { s.y + s.n as f64 }
        }
        #[handles("robot")] impl Scaler { #[on] fn moved(&mut self, to: f64) { self.hold.send(to); } }
        impl Component for Scaler { fn step(&mut self, _: &Tick) -> Result { self.clear(); Ok(()) } }
        trocar_plugin!(Scaler);"#,
        "here the unit is a setting of the attribute before",
    ),
    (
        "name_of_a_command",
        r#"#[derive(Component)] #[component(provides("ctl"))] struct Cam { #[state] n: u64 }
        #[provides("ctl")] impl Cam {
            #[command(name = "2nd")] fn second(&mut self, #[arg(min = 1)] n: u64) { self.n = n; }
            #[read] fn look(s: &CamState) -> u64 { s.n }
        }
        impl Component for Cam { fn step(&mut self, _: &Tick) -> Result { self.second(1); Ok(()) } }
        trocar_plugin!(Cam);"#,
        "`2nd` is not a name",
    ),
    (
        "payload_without_a_layout",
        r#"#[derive(Payload, Clone, Copy)] struct Place { x: f64 }
        #[derive(Component)] #[component(provides("ctl"))] struct Cam { #[input] at: In<Place>, #[state] last: Place }
        #[provides("ctl")] impl Cam { #[command] fn go(&mut self, to: Place) { self.last = to; } }
        impl Component for Cam {}
        trocar_plugin!(Cam);"#,
        "a payload is `#[repr(C)]`: add it above the struct",
    ),
    (
        "default_of_another_type",
        r#"#[derive(Config)] struct Cfg { #[config(live, min = 0.0, max = 10.0, unit = "mm", default = "x")] limit: f64 }
        #[derive(Component)] struct Cam { #[config] cfg: Cfg }
        impl Component for Cam { fn step(&mut self, _: &Tick) -> Result { let _ = self.cfg.limit; Ok(()) } }
        trocar_plugin!(Cam);"#,
        "this field is a f64: a number is wanted",
    ),
];

#[test]
fn every_case_fails_with_its_sentence_at_its_place() {
    let project = Path::new(env!("CARGO_TARGET_TMPDIR")).join("refused");
    let _ = std::fs::remove_dir_all(&project);
    std::fs::create_dir_all(project.join("src/bin")).unwrap();
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest = format!(
        "[package]\nname = \"refused\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n[dependencies]\n\
         trocar-sdk = {{ path = {here:?} }}\n\n[workspace]\n"
    );
    std::fs::write(project.join("Cargo.toml"), manifest).unwrap();
    // The versions are the same as here, so nothing is asked of a registry.
    std::fs::copy(here.join("../../Cargo.lock"), project.join("Cargo.lock")).unwrap();
    // One case that compiles, so that no case fails because of its surroundings.
    let control = ("control", CONTROL, "", "");
    let alone = ALONE.iter().map(|(name, source, ..)| (name, source));
    let cases = CASES.iter().chain([&control]).map(|(name, source, ..)| (name, source));
    for (name, source) in cases.chain(alone) {
        let text = format!("#![allow(dead_code)]\nuse trocar_sdk::prelude::*;\n{source}\nfn main() {{}}\n");
        std::fs::write(project.join(format!("src/bin/{name}.rs")), text).unwrap();
    }
    let output = Command::new(env!("CARGO"))
        .args(["check", "--bins", "--keep-going", "--offline", "--message-format=json"])
        .current_dir(&project)
        .env("CARGO_TARGET_DIR", Path::new(env!("CARGO_TARGET_TMPDIR")).join("refused-target"))
        .output()
        .unwrap();
    let (said, log) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8_lossy(&output.stderr));
    let lines: Vec<Value> =
        said.lines().filter_map(|line| trocar_sdk::serde_json::from_str(line).ok()).collect();
    let errors = |name: &str| {
        let of = |v: &&Value| v["target"]["name"] == name && v["message"]["level"] == "error";
        lines.iter().filter(of).map(|v| &v["message"]).collect::<Vec<_>>()
    };
    assert_eq!(errors("control"), Vec::<&Value>::new());
    let checked = |v: &Value| v["reason"] == "compiler-artifact" && v["target"]["name"] == "control";
    assert!(lines.iter().any(checked), "the case that compiles was not reached:\n{log}");
    for (name, source, why, at) in CASES {
        let errors = errors(name);
        let fits = |e: &&&Value| {
            let said = e["message"].as_str().unwrap();
            let marked = e["spans"].as_array().unwrap().iter().any(|span| marks(span, at));
            said.contains(why) && (at.is_empty() || marked)
        };
        assert!(
            errors.iter().any(|e| fits(&e)),
            "{name}: {why:?} is not said at {at:?} of\n{source}\nbut:\n{}",
            errors.iter().map(|e| e["rendered"].as_str().unwrap()).collect::<String>()
        );
    }
    for (name, source, why) in ALONE {
        let said: Vec<_> = errors(name).iter().map(|e| e["rendered"].as_str().unwrap()).collect();
        // "could not compile … due to 1 previous error" comes without a code and a place.
        let said: Vec<_> = said.into_iter().filter(|text| text.contains("-->")).collect();
        assert!(
            said.len() == 1 && said[0].contains(why),
            "{name}: not {why:?} alone of\n{source}\nbut:\n{}",
            said.concat()
        );
    }
}

/// Tells whether the span, or the span it is expanded from, is `wanted` in the source.
fn marks(span: &Value, wanted: &str) -> bool {
    if span.is_null() {
        return false;
    }
    let text = &span["text"][0];
    let column = |key: &str| text[key].as_u64().map_or(0, |n| n as usize - 1);
    let marked =
        text["text"].as_str().and_then(|t| t.get(column("highlight_start")..column("highlight_end")));
    marked == Some(wanted) || marks(&span["expansion"]["span"], wanted)
}
