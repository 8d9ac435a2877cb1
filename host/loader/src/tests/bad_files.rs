//! Every kind of bad file gets its one sentence, and the store lives on.

use super::*;

fn said(fault: &Fault, parts: &[&str]) {
    let text = fault.to_string();
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
    assert!(!text.contains('\n'), "more than one line: {text}");
}

/// The fault of a file with these bytes.
fn fault_of(bytes: &[u8]) -> Fault {
    let world = World::new();
    world.put("x.so", bytes);
    world.fault("x.so")
}

#[test]
fn an_empty_file_is_refused() {
    said(&fault_of(b""), &["is empty", "copy it again"]);
}

#[test]
fn a_text_file_is_refused() {
    said(&fault_of(b"hello, this is no library\n"), &["text file"]);
    said(&fault_of(&[0, 1, 2, 3]), &["not an ELF file"]);
}

#[test]
fn every_truncation_is_refused() {
    let whole = probe();
    for len in 1..whole.len() {
        let fault = facts_of(&whole[..len]).err();
        assert!(matches!(fault, Some(Fault::Truncated { .. })), "{len} of {} bytes: {fault:?}", whole.len());
    }
    said(&fault_of(&whole[..whole.len() / 2]), &["truncated", "copy it again, completely"]);
}

#[test]
fn a_library_of_another_machine_names_both() {
    let mut bytes = probe().to_vec();
    let other: u16 = if cfg!(target_arch = "x86_64") { 183 } else { 62 };
    bytes[18..20].copy_from_slice(&other.to_le_bytes());
    let (theirs, ours) =
        if cfg!(target_arch = "x86_64") { ("aarch64", "x86-64") } else { ("x86-64", "aarch64") };
    said(&fault_of(&bytes), &[&format!("built for {theirs}, this host is {ours}")]);
    bytes[5] = 2;
    said(&fault_of(&bytes), &["big-endian"]);
}

#[test]
fn executables_are_refused() {
    let world = World::new();
    let main = "int main(void) { return 0; }";
    let exe = world.beside("exe");
    compile(&world.beside("exe.c"), main, &exe, &["-pie".into()]);
    said(&fault_of(&std::fs::read(&exe).unwrap()), &["is an executable", "cdylib"]);
    compile(&world.beside("exe.c"), main, &exe, &["-no-pie".into()]);
    said(&fault_of(&std::fs::read(&exe).unwrap()), &["is an executable"]);
    compile(&world.beside("exe.c"), main, &exe, &["-c".into()]);
    said(&fault_of(&std::fs::read(&exe).unwrap()), &["object file", "-shared"]);
}

#[test]
fn a_library_without_a_manifest_is_refused() {
    let world = World::new();
    let out = world.beside("plain.so");
    compile(&world.beside("plain.c"), "int f(void) { return 1; }", &out, &["-shared".into()]);
    said(&fault_of(&std::fs::read(&out).unwrap()), &["no trocar plugin", ".note.trocar"]);
}

#[test]
fn an_abi_too_new_or_too_old_names_both() {
    let newer = Source { abi: [2, 3], ..Source::default() }.build();
    let fault = fault_of(&newer);
    said(&fault, &["speaks ABI 2.3, this host speaks 1.", "update the host"]);
    assert_eq!(fault.reason(), "PLUGIN_ABI");
    let older = Source { abi: [0, 9], ..Source::default() }.build();
    said(&fault_of(&older), &["speaks ABI 0.9", "rebuild the plugin"]);
}

#[test]
fn a_newer_major_is_named_even_when_its_manifest_is_not_understood() {
    let manifest = Some(r#"{"trocar":9,"abi":[7,0],"all":"different"}"#.to_string());
    said(&fault_of(&Source { manifest, ..Source::default() }.build()), &["ABI 7.0"]);
}

#[test]
fn a_manifest_that_is_not_understood_says_where() {
    let manifest = Some(r#"{"trocar":1,"abi":[1,0],"name":"x"}"#.to_string());
    said(&fault_of(&Source { manifest, ..Source::default() }.build()), &["missing field `version`"]);
}

#[test]
fn a_plugin_that_cannot_unwind_is_refused() {
    let bytes = Source { panic: "unwind", ..Source::default() }.build();
    said(&fault_of(&bytes), &["panic = \"abort\"", "panic = \"unwind\""]);
}

#[test]
fn a_missing_needed_library_is_named() {
    let world = World::new();
    let lib = world.beside("libtrocar_gone.so");
    compile(&world.beside("gone.c"), "int f(void) { return 1; }", &lib, &["-shared".into()]);
    let flags = vec!["-shared".into(), "-Wl,--no-as-needed".into(), lib.display().to_string()];
    let by_path = Source { flags, ..Source::default() }.build();
    said(&fault_of(&by_path), &["by its path", "libtrocar_gone.so"]);
    let here = format!("-L{}", lib.parent().unwrap().display());
    let flags = vec!["-shared".into(), "-Wl,--no-as-needed".into(), here, "-ltrocar_gone".into()];
    let by_name = Source { flags, ..Source::default() }.build();
    said(&fault_of(&by_name), &["needs the library `libtrocar_gone.so`"]);
}

#[test]
fn a_run_path_other_than_origin_is_refused() {
    let with = |path: &str| {
        let flags = vec!["-shared".into(), format!("-Wl,-rpath,{path}")];
        Source { flags, ..Source::default() }.build()
    };
    said(&fault_of(&with("/tmp/evil")), &["search path `/tmp/evil`"]);
    assert!(facts_of(&with("$ORIGIN")).is_ok());
}

#[test]
fn world_writable_files_are_refused() {
    let world = World::new();
    chmod(&world.put("x.so", probe()), 0o646);
    let fault = world.fault("x.so");
    said(&fault, &["mode 646", "chmod go-w"]);
    assert_eq!(fault.reason(), "PLUGIN_UNTRUSTED");
}

#[test]
fn files_of_another_user_are_refused() {
    let world = World::new();
    let path = world.put("x.so", probe());
    if std::os::unix::fs::chown(&path, Some(65534), None).is_err() {
        eprintln!("not run: giving a file away needs root");
        return;
    }
    said(&world.fault("x.so"), &["belongs to user 65534"]);
}

#[test]
fn group_writable_files_are_listed_with_a_warning_in_dev_and_refused_in_strict_mode() {
    let mut world = World::new();
    chmod(&world.put("x.so", probe()), 0o664);
    let store = world.open();
    let warnings = &store.class("probe_class").unwrap().plugin.warnings;
    assert!(warnings[0].contains("mode 664"), "{warnings:?}");
    world.trust = Trust::AllowList(AllowList::new("list.json", [Hash::of(probe())]));
    said(&world.fault("x.so"), &["chmod g-w"]);
}

#[test]
fn symbolic_links_are_followed_inside_the_directory_in_dev_and_never_in_strict_mode() {
    let mut world = World::new();
    world.put("libprobe.so", probe());
    std::fs::rename(world.path("libprobe.so"), world.path("libprobe.so.1")).unwrap();
    std::os::unix::fs::symlink("libprobe.so.1", world.path("libprobe.so")).unwrap();
    assert!(world.open().class("probe_class").is_ok());
    world.trust = Trust::AllowList(AllowList::new("list.json", [Hash::of(probe())]));
    said(&world.fault("libprobe.so"), &["symbolic link", "copy the file"]);
}

#[test]
fn a_symbolic_link_out_of_the_directory_is_refused() {
    let world = World::new();
    std::fs::write(world.beside("outside.so"), probe()).unwrap();
    std::os::unix::fs::symlink("../outside.so", world.path("x.so")).unwrap();
    said(&world.fault("x.so"), &["leads out of the plugin directory"]);
}

#[test]
fn a_file_outside_the_allow_list_is_refused_with_its_hash() {
    let mut world = World::new();
    world.put("x.so", probe());
    world.trust = Trust::AllowList(AllowList::new("list.json", []));
    said(&world.fault("x.so"), &["allow list list.json", &Hash::of(probe()).to_string()]);
}

#[test]
fn a_fifo_is_refused_and_holds_nobody_up() {
    let world = World::new();
    let made = Command::new("mkfifo").arg(world.path("x.so")).status().unwrap();
    assert!(made.success());
    said(&world.fault("x.so"), &["is a FIFO"]);
}

#[test]
fn a_directory_and_a_sparse_giant_are_refused() {
    let world = World::new();
    std::fs::create_dir(world.path("d.so")).unwrap();
    let giant = std::fs::File::create(world.path("giant.so")).unwrap();
    giant.set_len(4 << 30).unwrap();
    said(&world.fault("d.so"), &["is a directory"]);
    said(&world.fault("giant.so"), &["4096 MiB", "256 MiB"]);
}

#[test]
fn two_files_with_one_plugin_name_name_both() {
    let world = World::new();
    world.put("liba.so", probe());
    world.put("libb.so", &Source { code: "int more;", ..Source::default() }.build());
    said(&world.fault("libb.so"), &["plugin name `probe`", "liba.so"]);
    assert_eq!(world.open().classes().len(), 1);
}

#[test]
fn dotfiles_and_other_names_are_not_looked_at() {
    let world = World::new();
    world.put(".hidden.so", b"");
    world.put("readme.txt", b"");
    world.put("libx.so.tmp", b"");
    assert!(world.open().list().is_empty());
}

#[test]
fn an_undefined_symbol_is_named() {
    let code = "extern int trocar_nobody_has_this(void); int use(void) { return trocar_nobody_has_this(); }
                __attribute__((visibility(\"default\"))) int keep(void) { return use(); }";
    let world = World::new();
    world.put("x.so", &Source { code, ..Source::default() }.build());
    said(&world.load_fault("probe_class"), &["`trocar_nobody_has_this`", "nothing defines"]);
}

#[test]
fn a_missing_entry_is_refused() {
    let world = World::new();
    world.put("x.so", &Source { entry: "another_name", ..Source::default() }.build());
    said(&world.load_fault("probe_class"), &["does not export `trocar_plugin_v1`"]);
}

#[test]
fn an_entry_that_contradicts_the_manifest_is_refused() {
    let world = World::new();
    world.put("x.so", &Source { entry_class: "impostor", ..Source::default() }.build());
    said(&world.load_fault("probe_class"), &["class `probe_class` in the manifest, `impostor` in the entry"]);
}

#[test]
fn a_layout_description_of_an_unknown_kind_is_refused() {
    let code = "static const char other[256] = \"another abi_stable\";
                __attribute__((visibility(\"default\"))) const void *trocar_layout_v1(void) { return other; }";
    let world = World::new();
    world.put("x.so", &Source { code, ..Source::default() }.build());
    let fault = world.load_fault("probe_class");
    said(&fault, &["another layout of the contract", "another abi_stable"]);
    assert_eq!(fault.reason(), "PLUGIN_ABI");
}

#[test]
fn a_constructor_that_crashes_only_kills_the_child() {
    let code = "__attribute__((constructor)) static void crash(void) { *(volatile int *)8 = 1; }";
    let world = World::new();
    world.put("x.so", &Source { code, ..Source::default() }.build());
    said(&world.load_fault("probe_class"), &["crashes while its constructors run", "SIGSEGV"]);
}

#[test]
fn a_constructor_that_exits_is_told_from_a_crash() {
    let code = "#include <stdlib.h>\n__attribute__((constructor)) static void leave(void) { exit(7); }";
    let world = World::new();
    world.put("x.so", &Source { code, ..Source::default() }.build());
    said(&world.load_fault("probe_class"), &["ends the process with code 7"]);
}

#[test]
fn a_constructor_that_never_returns_is_ended() {
    let code =
        "#include <unistd.h>\n__attribute__((constructor)) static void hang(void) { for (;;) pause(); }";
    let mut world = World::new();
    world.vet_limit = Duration::from_millis(1500);
    world.put("x.so", &Source { code, ..Source::default() }.build());
    said(&world.load_fault("probe_class"), &["does not come back within 1 s while its constructors run"]);
}
