//! A world for loader tests: a plugin directory, a state directory, and tiny C plugins compiled on the spot.
//!
//! Invariant: every test owns its directories. The vetting child is this test binary, see `__vet_child`.
#![allow(clippy::unwrap_used)]

mod bad_files;
mod brought;
mod good_files;
mod hostile;
mod leaving;
mod tables;
mod watching;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use super::*;

/// The host binary's subcommand, as a test: `TEST_BINARY __vet FILE` selects this test and nothing else.
#[test]
fn __vet_child() {
    let mut args = std::env::args().skip(1);
    if let (Some(verb), Some(file)) = (args.next(), args.next())
        && verb == VET_ARG
    {
        let _ = vet_main(Path::new(&file));
        std::process::exit(1);
    }
}

pub(super) struct World {
    root: tempfile::TempDir,
    pub(super) trust: Trust,
    pub(super) vet_limit: Duration,
}

impl World {
    pub(super) fn new() -> World {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir(root.path().join("plugins")).unwrap();
        World { root, trust: Trust::Dev, vet_limit: Duration::from_secs(60) }
    }

    /// The path of `name` in the plugin directory.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.root.path().join("plugins").join(name)
    }

    /// A path beside the plugin directory.
    pub(super) fn beside(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    /// A whole file at once, as `mv` does it, and not writable by others whatever the umask is.
    pub(super) fn put(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let made = self.beside("made");
        std::fs::write(&made, bytes).unwrap();
        chmod(&made, 0o644);
        std::fs::rename(&made, self.path(name)).unwrap();
        self.path(name)
    }

    pub(super) fn config(&self) -> PluginStoreConfig {
        let exe = std::env::current_exe().unwrap();
        let config = PluginStoreConfig::new(vec![self.path("")], self.beside("state"), exe);
        PluginStoreConfig { trust: self.trust.clone(), ..config }
    }

    pub(super) fn open(&self) -> Arc<PluginStore> {
        PluginStore::open_with_limit(self.config(), self.vet_limit).unwrap()
    }

    /// Why the file is refused at the first look.
    pub(super) fn fault(&self, name: &str) -> Fault {
        let store = self.open();
        let entries = store.list();
        let entry = entries.iter().find(|e| e.file() == &self.path(name));
        match entry {
            Some(PluginEntry::Refused { reason: PluginError::Refused { fault, .. }, .. }) => fault.clone(),
            other => panic!("{name} is not refused but {other:?}"),
        }
    }

    /// Why the plugin is listed but cannot be loaded.
    pub(super) fn load_fault(&self, class: &str) -> Fault {
        let store = self.open();
        let class = store.class(class).unwrap_or_else(|e| panic!("not listed: {e}"));
        match store.load(&class) {
            Err(PluginError::Refused { fault, .. }) => fault,
            Err(other) => panic!("refused for another reason: {other}"),
            Ok(_) => panic!("{} was loaded", class.full_name()),
        }
    }
}

pub(super) fn chmod(path: &Path, mode: u32) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
}

/// A C plugin with one class; every part that a test wants wrong can be replaced.
pub(super) struct Source {
    pub(super) name: &'static str,
    pub(super) abi: [u32; 2],
    pub(super) panic: &'static str,
    /// Replaces the whole manifest.
    pub(super) manifest: Option<String>,
    /// The class name in the entry's table; the manifest says `probe_class`.
    pub(super) entry_class: &'static str,
    /// C code before the tables.
    pub(super) code: &'static str,
    /// The name of the entry function.
    pub(super) entry: &'static str,
    pub(super) flags: Vec<String>,
}

impl Default for Source {
    fn default() -> Source {
        Source {
            name: "probe",
            abi: [1, 0],
            panic: "none",
            manifest: None,
            entry_class: "probe_class",
            code: "",
            entry: "trocar_plugin_v1",
            flags: vec!["-shared".into()],
        }
    }
}

impl Source {
    pub(super) fn manifest_text(&self) -> String {
        self.manifest.clone().unwrap_or_else(|| {
            format!(
                r#"{{"trocar":1,"abi":[{},{}],"name":"{}","version":"0.1.0","panic":"{}",
                "classes":[{{"name":"probe_class","doc":"for tests"}}]}}"#,
                self.abi[0], self.abi[1], self.name, self.panic
            )
        })
    }

    /// Compiles with the system's C compiler and returns the library's bytes.
    pub(super) fn build(&self) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("manifest.json"), self.manifest_text()).unwrap();
        let source = TEMPLATE
            .replace("@MANIFEST@", at("manifest.json").to_str().unwrap())
            .replace("@CODE@", self.code)
            .replace("@ENTRY@", self.entry)
            .replace("@NAME@", self.name)
            .replace("@CLASS@", self.entry_class);
        compile(&at("probe.c"), &source, &at("probe.so"), &self.flags);
        std::fs::read(at("probe.so")).unwrap()
    }
}

pub(super) fn compile(file: &Path, source: &str, out: &Path, flags: &[String]) {
    std::fs::write(file, source).unwrap();
    let done = Command::new("cc")
        .args(["-fPIC", "-O1", "-fvisibility=hidden", "-o"])
        .args([out, file])
        .args(flags)
        .output()
        .expect("a C compiler named cc");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}

/// The facts of bytes that have nothing beside them.
pub(super) fn facts_of(bytes: &[u8]) -> Result<inspect::Facts, Fault> {
    inspect::inspect_bytes(bytes, &mut |_, _| Err(Fault::Vanished))
}

/// The plain probe, compiled once.
pub(super) fn probe() -> &'static [u8] {
    static PROBE: OnceLock<Vec<u8>> = OnceLock::new();
    PROBE.get_or_init(|| Source::default().build())
}

/// Its class table ends behind `destroy`, as that of a very old plugin would.
const TEMPLATE: &str = r#"
#include <stddef.h>
#include <stdint.h>
__asm__(".pushsection .note.trocar,\"a\",@note\n.balign 4\n.long 7\n.long 2f-1f\n.long 1\n"
        ".asciz \"TROCAR\"\n.balign 4\n1: .incbin \"@MANIFEST@\"\n2: .balign 4\n.popsection\n");
@CODE@
typedef struct { const char *ptr; size_t len; } bytes;
#define TEXT(s) { s, sizeof s - 1 }
static int made;
static void *create(const void *host, bytes name, void *err) { return &made; }
static void destroy(void *self) {}
static const struct {
  uint32_t size, flags; bytes name;
  void *(*create)(const void *, bytes, void *); void (*destroy)(void *);
} class_table = { sizeof class_table, 0, TEXT("@CLASS@"), create, destroy };
static const void *const classes[] = { &class_table };
static int init(const void *host) { return 0; }
static const struct {
  uint32_t size, flags, major, minor; bytes name, version;
  int (*init)(const void *); uint32_t count, reserved; const void *const *classes;
} table = { sizeof table, 0, 1, 0, TEXT("@NAME@"), TEXT("0.1.0"), init, 1, 0, classes };
__attribute__((visibility("default"))) const void *@ENTRY@(void) { return &table; }
"#;
