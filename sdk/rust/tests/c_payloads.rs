//! `sdk/c/trocar_payloads.h` is written from `trocar_sdk::data`; C and C++ compilers lay it out as Rust does.
//!
//! Invariant: the committed file is what `c_payloads/written.rs` writes; `TROCAR_BLESS=1` writes it anew.
#![allow(clippy::unwrap_used)]

#[path = "c_payloads/written.rs"]
mod written;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use trocar_plugin_api::manifest::{Manifest, NamedType};
use trocar_sdk::data::*;
use trocar_sdk::{StaticPlugin, prelude::*, static_plugin};

macro_rules! every_payload {
    ($($port:ident: $payload:ident),+ $(,)?) => {
        /// An output of each standard payload, so that its manifest has the types of all.
        #[derive(Component)]
        struct Every { $(#[output] $port: Out<$payload>,)+ }
    };
}
every_payload! {
    scalar: Scalar, message: Message, pose: Pose, twist: Twist, wrench: Wrench, cartesian_state: CartesianState,
    transform: Transform, joint_state: JointState, joint_configuration: JointConfiguration, arm_state: ArmState,
    operating_state: OperatingState, virtual_fixture: VirtualFixture, retreat: Retreat, tool_pose: ToolPose,
    tracked_tools: TrackedTools, force_range: ForceRange, input_state: InputState, input_layout: InputLayout,
    button_event: ButtonEvent, image_header: ImageHeader, stereo_header: StereoHeader,
    camera_geometry: CameraGeometry, spectra_header: SpectraHeader, ascan_header: AScanHeader,
    spectrometer: Spectrometer, distance: Distance,
}
impl Component for Every {}

const EVERY: StaticPlugin = static_plugin!(name = "every", Every);

fn types() -> Vec<NamedType> {
    written::by_need(Manifest::parse(EVERY.manifest.as_bytes()).unwrap().types)
}

fn c_dir() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../c")
}

#[test]
fn every_payload_of_the_sdk_is_in_the_header() {
    let types = types();
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/data");
    let mut found = 0;
    for file in std::fs::read_dir(dir).unwrap() {
        let source = std::fs::read_to_string(file.unwrap().path()).unwrap();
        let mut payload = false;
        for line in source.lines().map(str::trim) {
            payload |= line.starts_with("#[derive(Payload") || line.starts_with("named_values!");
            let Some(rest) = line.strip_prefix("pub struct ").filter(|_| payload) else { continue };
            let name = rest.split(|c: char| !c.is_alphanumeric()).next().unwrap();
            assert!(types.iter().any(|t| t.name == name), "{name} is missing: name it in `every_payload!`");
            (payload, found) = (false, found + 1);
        }
    }
    assert_eq!(found, types.len());
}

#[test]
fn the_committed_header_is_the_one_that_is_written() {
    let (header, path) = (written::header(&types()), c_dir().join("trocar_payloads.h"));
    if std::env::var_os("TROCAR_BLESS").is_some() {
        std::fs::write(&path, &header).unwrap();
    }
    let there = std::fs::read_to_string(path).unwrap_or_default();
    let differs = header.lines().zip(there.lines()).find(|(now, then)| now != then);
    assert!(
        header == there,
        "trocar_payloads.h is not what the payloads say, first at {differs:?}; if that is meant: TROCAR_BLESS=1 cargo \
         test -p trocar-sdk --test c_payloads"
    );
    let long = header.lines().find(|line| line.chars().count() > 110);
    assert_eq!(long, None);
}

/// Compiles `source` with warnings as errors and returns the output of the program.
fn printed(language: &str, name: &str, compiler: &str, options: &[&str], source: &str) -> String {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c_payloads").join(language);
    std::fs::create_dir_all(&dir).unwrap();
    let (file, program) = (dir.join(format!("{name}.{language}")), dir.join(name));
    std::fs::write(&file, source).unwrap();
    let run = |command: &mut Command| {
        let done = command.output().unwrap_or_else(|e| panic!("{command:?} does not run: {e}"));
        assert!(done.status.success(), "{command:?}:\n{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8(done.stdout).unwrap()
    };
    let options = options.iter().chain(&["-Wall", "-Wextra", "-Werror", "-I"]);
    run(Command::new(compiler).args(options).arg(c_dir()).arg(file).arg("-o").arg(&program));
    run(&mut Command::new(program))
}

/// Returns a program that prints sizes, offsets and values, each on a line, by the names that `name` gives
/// the types.
fn program(name: impl Fn(&NamedType) -> String) -> (String, String) {
    let mut source = String::from("#include \"trocar_payloads.h\"\n#include <stdio.h>\nint main(void) {\n");
    let mut want = String::new();
    for ty in types() {
        let c = name(&ty);
        writeln!(source, "printf(\"{c} %zu\\n\", sizeof({c}));").unwrap();
        writeln!(want, "{c} {}", ty.size).unwrap();
        for field in &ty.fields {
            let field_name = &field.name;
            writeln!(source, "printf(\"{c}.{field_name} %zu\\n\", offsetof({c}, {field_name}));").unwrap();
            writeln!(want, "{c}.{field_name} {}", field.at).unwrap();
        }
        for value in &ty.values {
            let constant = format!("TROCAR_{}_{}", written::upper(&ty.name), value.name);
            writeln!(source, "printf(\"{constant} %lld\\n\", (long long){constant});").unwrap();
            writeln!(want, "{constant} {}", value.value).unwrap();
        }
        let json = format!("TROCAR_TYPE_{}", written::upper(&ty.name));
        writeln!(source, "printf(\"%s\\n\", {json});").unwrap();
        writeln!(want, "{}", trocar_sdk::serde_json::to_string(&ty).unwrap()).unwrap();
    }
    source.push_str("return 0; }\n");
    (source, want)
}

fn compiler(variable: &str, otherwise: &str) -> String {
    std::env::var(variable).unwrap_or_else(|_| otherwise.into())
}

#[test]
fn c_has_the_sizes_offsets_values_and_manifest_types_of_rust() {
    let (source, want) = program(|ty| written::c_name(&ty.name));
    let have = printed("c", "sizes", &compiler("CC", "cc"), &["-std=c11"], &source);
    assert_eq!(have, want);
}

#[test]
fn cpp_has_them_by_the_names_of_rust() {
    let (source, want) = program(|ty| format!("trocar::data::{}", ty.name));
    let have = printed("cpp", "sizes", &compiler("CXX", "c++"), &["-std=c++17"], &source);
    assert_eq!(have, want);
}

#[test]
fn a_manifest_of_the_macros_is_read_as_the_one_of_rust() {
    let mut source =
        String::from("#include \"trocar_payloads.h\"\n#include <stdio.h>\nint main(void) { puts(");
    source.push_str("TROCAR_JSON({\"trocar\":1,\"abi\":[1,2],\"name\":\"c\",\"version\":\"0\",\"doc\":\"a (b), \\\"c\\\"\",\"types\":[)\n");
    let all: Vec<String> =
        types().iter().map(|ty| format!("TROCAR_TYPE_{}", written::upper(&ty.name))).collect();
    source.push_str(&all.join(" \",\"\n"));
    source.push_str("\nTROCAR_JSON(],\"classes\":[]})); return 0; }\n");
    for (language, compiler, standard) in
        [("c", compiler("CC", "cc"), "-std=c11"), ("cpp", compiler("CXX", "c++"), "-std=c++17")]
    {
        let said = printed(language, "json", &compiler, &[standard], &source);
        let manifest = Manifest::parse(said.as_bytes()).unwrap();
        assert_eq!((manifest.types, manifest.doc.as_str()), (types(), "a (b), \"c\""));
    }
}

#[test]
fn the_manifest_shown_in_c_is_one() {
    let page = std::fs::read_to_string(c_dir().join("../../docs/C_PLUGINS.md")).unwrap();
    let shown = page.split("```c\n").nth(1).unwrap().split("\n```").next().unwrap();
    let mut source = format!("#include \"trocar_payloads.h\"\n#include <stdio.h>\n{shown}\n");
    source.push_str("int main(void) { puts(trocar_manifest_note.desc); return 0; }\n");
    let said = printed("c", "shown", &compiler("CC", "cc"), &["-std=c11"], &source);
    let manifest = Manifest::parse(said.as_bytes()).unwrap();
    let names: Vec<&str> = manifest.types.iter().map(|t| t.name.as_str()).collect();
    assert_eq!((names, manifest.classes.len()), (vec!["Scalar", "Pose"], 1));
}
