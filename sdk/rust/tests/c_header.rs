//! `sdk/c/trocar_plugin.h` says what `trocar-plugin-api` says: every size, offset and constant, asked from a
//! C compiler.
//!
//! Invariant: the lists below are complete; a field left out leaves a gap that the first test finds.
#![allow(clippy::unwrap_used)]

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use trocar_plugin_api::abi;

/// A struct in both languages: names, then per field its name, offset and size in bytes.
struct Both {
    c: &'static str,
    size: usize,
    fields: Vec<(&'static str, usize, usize)>,
}

fn size_of_field<T, F>(_: fn(&T) -> &F) -> usize {
    size_of::<F>()
}

macro_rules! both {
    ($($c:ident = $rust:ident { $($field:ident),+ $(,)? })+) => {
        vec![$(Both {
            c: stringify!($c),
            size: size_of::<abi::$rust>(),
            fields: vec![$((
                stringify!($field),
                core::mem::offset_of!(abi::$rust, $field),
                size_of_field(|s: &abi::$rust| &s.$field),
            )),+],
        }),+]
    };
}

fn structs() -> Vec<Both> {
    both! {
        trocar_bytes = Bytes { ptr, len }
        trocar_err = ErrBuf { ptr, cap, len }
        trocar_sink = Sink { ctx, write }
        trocar_tick = Tick { struct_size, flags, cycle, now_ns, deadline_ns, period_ns, elapsed_ns }
        trocar_loan = Loan { struct_size, flags, header, bytes, capacity, token }
        trocar_sample = SampleView { struct_size, flags, header, bytes, len, stamp_ns, seq, token }
        trocar_out = OutSlot { struct_size, flags, ctx, write, loan, commit, cancel, forward, reserve, type_of, write_bytes }
        trocar_in = InSlot { struct_size, flags, ctx, latest, next, release, writable, type_of, header_len, hold }
        trocar_held = Held { struct_size, flags, bytes, len, token, release }
        trocar_call_opts = CallOpts { struct_size, mode, deadline_ns, err, stamp_ns, may_still_run, reserved }
        trocar_fn = FnSlot { struct_size, flags, ctx, call, type_of, call_bytes }
        trocar_event = EventSlot { struct_size, flags, ctx, emit }
        trocar_ports = Ports {
            struct_size, output_count, input_count, function_count, event_count, reserved,
            outputs, inputs, functions, events,
        }
        trocar_host = HostTable {
            struct_size, flags, abi_major, abi_minor, ctx, now_ns, log, service, callback_enter, callback_leave,
            extension, ports_changed,
        }
        trocar_slice_body = SliceBody { data, run }
        trocar_parallel = Parallel { struct_size, flags, ctx, threads, run }
        trocar_keep = Keep { struct_size, flags, keep }
        trocar_class = ClassTable {
            struct_size, flags, name, create, destroy, configure, describe, bind, start, stop, resume, make_safe,
            step, command, read, on_event, on_service, state_copy, snapshot, restore, extension,
        }
        trocar_plugin = PluginTable {
            struct_size, flags, abi_major, abi_minor, name, version, init, class_count, reserved, classes,
        }
    }
}

macro_rules! constants {
    ($($c:ident = $rust:ident),+ $(,)?) => { vec![$((stringify!($c), i64::from(abi::$rust))),+] };
}

fn constants() -> Vec<(&'static str, i64)> {
    constants![
        TROCAR_ABI_MAJOR = ABI_MAJOR,
        TROCAR_ABI_MINOR = ABI_MINOR,
        TROCAR_STATUS_OK = STATUS_OK,
        TROCAR_STATUS_FAILED = STATUS_FAILED,
        TROCAR_STATUS_PANICKED = STATUS_PANICKED,
        TROCAR_STATUS_INVALID = STATUS_INVALID,
        TROCAR_STATUS_UNSUPPORTED = STATUS_UNSUPPORTED,
        TROCAR_EXECUTED = EXECUTED,
        TROCAR_QUEUED = QUEUED,
        TROCAR_UNBOUND = UNBOUND,
        TROCAR_QUEUE_FULL = QUEUE_FULL,
        TROCAR_WOULD_BLOCK = WOULD_BLOCK,
        TROCAR_DISABLED = DISABLED,
        TROCAR_INVALID_ARGUMENT = INVALID_ARGUMENT,
        TROCAR_FAILED = FAILED,
        TROCAR_DEADLINE = DEADLINE,
        TROCAR_PEER_LOST = PEER_LOST,
        TROCAR_NOT_ACTIVE = NOT_ACTIVE,
        TROCAR_EXHAUSTED = EXHAUSTED,
        TROCAR_SAMPLE_FRESH = SAMPLE_FRESH,
        TROCAR_SAMPLE_STALE = SAMPLE_STALE,
        TROCAR_IN_SAMPLE = IN_SAMPLE,
        TROCAR_IN_EMPTY = IN_EMPTY,
        TROCAR_IN_UNBOUND = IN_UNBOUND,
        TROCAR_MODE_SEND = MODE_SEND,
        TROCAR_MODE_CALL = MODE_CALL,
        TROCAR_LOG_ERROR = LOG_ERROR,
        TROCAR_LOG_WARN = LOG_WARN,
        TROCAR_LOG_INFO = LOG_INFO,
        TROCAR_LOG_DEBUG = LOG_DEBUG,
        TROCAR_LOG_TRACE = LOG_TRACE,
    ]
}

fn header_dir() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../c")
}

/// A directory of this test's own.
fn scratch(name: &str) -> PathBuf {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

fn run(command: &mut Command) -> String {
    let out =
        command.output().unwrap_or_else(|e| panic!("{command:?} does not run: {e}; a C compiler is needed"));
    assert!(out.status.success(), "{command:?}:\n{}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

#[test]
fn the_list_of_fields_leaves_no_gap() {
    for s in structs() {
        let mut end = 0;
        for (name, at, size) in &s.fields {
            assert_eq!(*at, end, "{}: what lies before `{name}`?", s.c);
            end = at + size;
        }
        assert_eq!(end, s.size, "{}: what lies at its end?", s.c);
    }
}

#[test]
fn the_c_header_has_the_same_sizes_offsets_and_constants() {
    let (mut source, mut want) = (String::new(), String::new());
    source.push_str("#include \"trocar_plugin.h\"\n#include <stdio.h>\nint main(void) {\n");
    for s in structs() {
        let c = s.c;
        writeln!(source, "printf(\"{c} %zu\\n\", sizeof({c}));").unwrap();
        writeln!(want, "{c} {}", s.size).unwrap();
        for (field, at, size) in s.fields {
            let of = format!("offsetof({c}, {field}), sizeof((({c} *)0)->{field})");
            writeln!(source, "printf(\"{c}.{field} %zu %zu\\n\", {of});").unwrap();
            writeln!(want, "{c}.{field} {at} {size}").unwrap();
        }
    }
    for (name, value) in constants() {
        writeln!(source, "printf(\"{name} %lld\\n\", (long long){name});").unwrap();
        writeln!(want, "{name} {value}").unwrap();
    }
    source.push_str("return 0; }\n");
    let dir = scratch("c_header");
    std::fs::write(dir.join("sizes.c"), source).unwrap();
    let compiler = std::env::var_os("CC").unwrap_or_else(|| "cc".into());
    let warnings = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"];
    run(Command::new(compiler)
        .args(warnings)
        .arg(header_dir())
        .arg(dir.join("sizes.c"))
        .arg("-o")
        .arg(dir.join("sizes")));
    let have = run(&mut Command::new(dir.join("sizes")));
    let differ: Vec<_> = have.lines().zip(want.lines()).filter(|(h, w)| h != w).collect();
    assert!(differ.is_empty() && have == want, "C says, Rust says: {differ:#?}");
}

#[test]
fn a_manifest_written_with_the_header_is_a_note_that_parses() {
    let dir = scratch("c_note");
    let source = "#include \"trocar_plugin.h\"\n\
        TROCAR_MANIFEST(\"{\\\"trocar\\\":1,\\\"abi\\\":[1,0],\\\"name\\\":\\\"c\\\",\\\"version\\\":\\\"0\\\",\\\"classes\\\":[]}\");\n\
        TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { return 0; }\n";
    std::fs::write(dir.join("note.c"), source).unwrap();
    let compiler = std::env::var_os("CC").unwrap_or_else(|| "cc".into());
    let options =
        ["-std=c11", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-Wl,--gc-sections", "-s", "-I"];
    let library = dir.join("libnote.so");
    run(Command::new(compiler)
        .args(options)
        .arg(header_dir())
        .arg(dir.join("note.c"))
        .arg("-o")
        .arg(&library));
    let file = std::fs::read(library).unwrap();
    let owner = b"\x01\0\0\0TROCAR\0\0";
    let at = file.windows(owner.len()).position(|w| w == owner).expect("the note is in the file");
    let size = u32::from_le_bytes(file[at - 4..at].try_into().unwrap()) as usize;
    let text = &file[at + owner.len()..at + owner.len() + size];
    assert_eq!(trocar_plugin_api::manifest::Manifest::parse(text).unwrap().name, "c");
}

#[test]
fn the_header_says_how_a_manifest_declares_what_a_class_is_made_to_run_by() {
    let header = std::fs::read_to_string(header_dir().join("trocar_plugin.h")).unwrap();
    let execution = r#""model":"periodic","period_ns":1000000"#;
    let made_for = [r#""models":["periodic","exec_in"]"#, r#""min_period_ns""#, r#""max_period_ns""#];
    for said in made_for.into_iter().chain([execution]) {
        assert!(header.contains(said), "the header does not say {said}");
    }
    let [models, min, max] = made_for;
    let manifest = format!(
        r#"{{"trocar":1,"abi":[1,2],"name":"c","version":"0","panic":"none","classes":
        [{{"name":"c","execution":{{{execution},{models},{min}:125000,{max}:10000000}}}}]}}"#
    );
    let parsed = trocar_plugin_api::manifest::Manifest::parse(manifest.as_bytes()).unwrap();
    let execution = &parsed.classes[0].execution;
    assert_eq!((execution.min_period_ns, execution.max_period_ns), (125_000, 10_000_000));
}
