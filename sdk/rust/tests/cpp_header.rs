//! `sdk/c/trocar_plugin.hpp` keeps its promises: a C++ component is driven through its tables by a C++
//! program.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::process::Command;
use trocar_plugin_api::contracts::{leaves_of, size_of_type};
use trocar_plugin_api::manifest::{Manifest, NamedType, Type};
use trocar_sdk::serde_json;

fn c_dir() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../c")
}

/// Compiles one of the tests' C++ sources with `options` and returns the resulting file.
fn compiled(source: &str, name: &str, options: &[&str]) -> PathBuf {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cpp_header");
    std::fs::create_dir_all(&dir).unwrap();
    let (out, compiler) = (dir.join(name), std::env::var_os("CXX").unwrap_or_else(|| "c++".into()));
    let mut command = Command::new(compiler);
    command.args(["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]).args(options);
    command.arg("-I").arg(c_dir()).arg(c_dir().join("tests").join(source)).arg("-o").arg(&out);
    let done = command
        .output()
        .unwrap_or_else(|e| panic!("{command:?} does not run: {e}; a C++ compiler is needed"));
    assert!(done.status.success(), "{command:?}:\n{}", String::from_utf8_lossy(&done.stderr));
    out
}

#[test]
fn a_cpp_component_has_every_kind_of_member_and_answers_bad_input() {
    let done = Command::new(compiled("gauge.cpp", "gauge", &["-O1"])).output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{said}\n{}", String::from_utf8_lossy(&done.stderr));
}

#[test]
fn repeated_interfaces_of_a_cpp_component_have_commands_reads_and_handlers() {
    let done = Command::new(compiled("arms.cpp", "arms", &["-O1"])).output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{said}\n{}", String::from_utf8_lossy(&done.stderr));
}

/// A locale whose numbers have a decimal comma: the file the C library reads, made here because few machines
/// have one.
fn comma_locale(dir: &Path) -> &'static str {
    let words: [&[u8]; 6] = [
        b",\0",
        b".\0",
        b"\x03\x03\0",
        &u32::from(b',').to_ne_bytes(),
        &u32::from(b'.').to_ne_bytes(),
        b"UTF-8\0",
    ];
    let begin = 8 + 4 * words.len();
    let (mut places, mut data) = (Vec::new(), Vec::new());
    for word in words {
        while word.len() == 4 && !(begin + data.len()).is_multiple_of(4) {
            data.push(0);
        }
        places.push(begin + data.len());
        data.extend(word);
    }
    let head = [0x2003_1114, words.len()].into_iter().chain(places);
    let mut file: Vec<u8> = head.flat_map(|n| (n as u32).to_ne_bytes()).collect();
    file.extend(data);
    let dir = dir.join("comma.UTF-8");
    std::fs::create_dir_all(&dir).unwrap();
    std::fs::write(dir.join("LC_NUMERIC"), file).unwrap();
    "comma.UTF-8"
}

#[test]
fn numbers_of_cpp_json_are_exact_in_every_locale_and_sizes_are_the_manifests() {
    let program = compiled("numbers.cpp", "numbers", &["-O1"]);
    let dir = program.parent().unwrap();
    let locale = comma_locale(dir);
    for locale in [None, Some(locale)] {
        let done = Command::new(&program).args(locale).env("LOCPATH", dir).output().unwrap();
        assert!(done.status.success(), "{locale:?}: {}", String::from_utf8_lossy(&done.stdout));
    }
}

/// The fenced blocks of one language of a page of the documentation.
fn blocks(page: &str, language: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs").join(page);
    let text = std::fs::read_to_string(path).unwrap();
    let of = |rest: &str| rest.split("\n```").next().unwrap().to_string();
    text.split(&format!("\n```{language}\n")).skip(1).map(of).collect()
}

#[test]
fn the_cpp_of_the_page_is_one_plugin_that_the_shown_command_compiles() {
    let source = blocks("C_PLUGINS.md", "cpp");
    assert_eq!(source.len(), 2, "manifest and component; a further block is not covered here");
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cpp_pages");
    std::fs::create_dir_all(&dir).unwrap();
    std::fs::write(dir.join("gauge.cpp"), source.join("\n")).unwrap();
    let shell = blocks("C_PLUGINS.md", "sh").remove(0);
    let words: Vec<String> = shell
        .lines()
        .next()
        .unwrap()
        .split_whitespace()
        .map(
            |word| {
                if word == "sdk/c" { c_dir().display().to_string() } else { word.replace("NAME", "gauge") }
            },
        )
        .collect();
    assert_eq!(words[0], "g++");
    let compiler = std::env::var_os("CXX").unwrap_or_else(|| "c++".into());
    let done = Command::new(compiler)
        .args(["-Wall", "-Wextra", "-Werror"])
        .args(&words[1..])
        .current_dir(&dir)
        .output();
    let done = done.unwrap();
    assert!(done.status.success(), "{words:?}:\n{}", String::from_utf8_lossy(&done.stderr));
    let manifest = manifest_of(&dir.join("libtrocar_gauge.so"));
    assert_eq!((manifest.name.as_str(), manifest.classes[0].inputs[0].name.as_str()), ("gauge", "x"));
}

#[test]
fn the_types_shown_for_a_manifest_are_read_as_such() {
    let shown = blocks("C_PLUGINS.md", "json").concat();
    let types: Vec<NamedType> =
        serde_json::Deserializer::from_str(&shown).into_iter().collect::<Result<_, _>>().unwrap();
    let [force, mode] = types.as_slice() else { panic!("{types:?}") };
    assert_eq!(leaves_of(&types, &Type::Ref { name: "Force".into() }, "").unwrap().len(), force.fields.len());
    let of_fields =
        |ty: &NamedType| ty.fields.iter().map(|f| size_of_type(&types, &f.ty).unwrap()).sum::<usize>();
    assert_eq!((of_fields(force), force.fields[1].frame.as_str()), (force.size, "sensor"));
    assert_eq!((mode.repr.as_deref(), mode.values.len()), (Some("u8"), 2));
    // No key of theirs is lost on the way.
    for (ty, shown) in
        types.iter().zip(serde_json::Deserializer::from_str(&shown).into_iter::<serde_json::Value>())
    {
        let shown = shown.unwrap();
        let read = serde_json::to_value(ty).unwrap();
        let known = ["name", "doc", "size", "align", "fields", "enum", "values"];
        assert!(shown.as_object().unwrap().keys().all(|key| known.contains(&key.as_str())), "{shown}");
        assert_eq!(read["size"], shown["size"]);
    }
}

fn manifest_of(library: &Path) -> Manifest {
    let file = std::fs::read(library).unwrap();
    let owner = b"\x01\0\0\0TROCAR\0\0";
    let at = file.windows(owner.len()).position(|w| w == owner).expect("the note is in the file");
    let size = u32::from_le_bytes(file[at - 4..at].try_into().unwrap()) as usize;
    Manifest::parse(&file[at + owner.len()..at + owner.len() + size]).unwrap()
}

#[test]
fn its_manifest_is_a_note_of_the_library() {
    let options = ["-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-Wl,--gc-sections"];
    let manifest = manifest_of(&compiled("gauge.cpp", "libgauge.so", &options));
    assert_eq!((manifest.name.as_str(), manifest.classes[0].doc.as_str()), ("cpp_gauge", "\"adds\" µ up"));
}
