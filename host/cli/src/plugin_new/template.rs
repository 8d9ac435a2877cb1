//! The templates of `trocar plugin new`: their files, what they are built with, and where the SDK for it is.
//!
//! Invariant: every file of `sdk/templates/NAME` is listed here, and nothing else is.

use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::super::failure::Failure;

/// The SDK that a new plugin is built with.
#[derive(Debug)]
pub(super) struct Sdk {
    /// For `{{sdk}}`.
    pub(super) text: String,
    /// Are its sources on this machine?
    pub(super) found: bool,
    /// The versions that trocar itself was built with. A plugin that begins with them wants none that is not
    /// on this machine already, which may have no network.
    pub(super) lock: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Template {
    /// Rust: a low-pass with an input, an output, a setting and a command.
    Filter,
    /// Rust: writes a signal of its own.
    Source,
    /// Rust: a sensor on a byte stream, read by a thread of its own; simulated without an address.
    Device,
    /// Rust: an arm behind the standard interface, with simulated joints.
    Arm,
    /// C++17: a low-pass, with a Makefile.
    Cpp,
    /// C11: a low-pass, with a Makefile.
    C,
}

/// Path and text with `{{…}}` places.
type File = (&'static str, &'static str);

macro_rules! files {
    ($of:literal: $($path:literal),+ $(,)?) => {
        &[
            (".gitignore", include_str!(concat!("../../../../sdk/templates/", $of, "/gitignore"))),
            $(($path, include_str!(concat!("../../../../sdk/templates/", $of, "/", $path)))),+
        ]
    };
}

impl Template {
    pub(super) const fn files(self) -> &'static [File] {
        match self {
            Template::Filter => files!("filter": "Cargo.toml", "src/lib.rs"),
            Template::Source => files!("source": "Cargo.toml", "src/lib.rs"),
            Template::Device => {
                files!("device": "Cargo.toml", "src/lib.rs", "src/reader.rs", "src/tests.rs")
            }
            Template::Arm => files!("arm": "Cargo.toml", "src/lib.rs", "src/drive.rs"),
            Template::Cpp => files!("cpp": "Makefile", "src/component.cpp", "src/test.cpp"),
            Template::C => files!("c": "Makefile", "src/component.c", "src/test.c"),
        }
    }

    const fn is_rust(self) -> bool {
        !matches!(self, Template::Cpp | Template::C)
    }

    /// The commands from the new directory to a running component.
    pub(super) fn next_steps(self, name: &str) -> String {
        let library = format!("lib{}.so", name.replace('-', "_"));
        let (steps, built) = if self.is_rust() {
            ("cargo test\n  cargo build --release", format!("target/release/{library}"))
        } else {
            ("make\n  make check", library)
        };
        format!(
            "{name}/ is ready. Next:\n  cd {name}\n  {steps}\n  cp {built} DIR/     # a plugin directory of a running host\n"
        )
    }

    /// The SDK of this template, beside this program or where it was said to be.
    ///
    /// # Errors
    /// The directory that was asked for is not the SDK.
    pub(super) fn sdk(self, asked: Option<&Path>) -> Result<Sdk, Failure> {
        let found = match asked {
            Some(dir) => Some(self.within(dir).ok_or_else(|| self.is_not_the_sdk(dir))?),
            None => std::env::current_exe()
                .ok()
                .and_then(|exe| exe.ancestors().find_map(|repo| self.within(&repo.join("sdk/rust")))),
        };
        let absolute = found.as_deref().map(|dir| dir.canonicalize().unwrap_or_else(|_| dir.to_owned()));
        let text = match (self.is_rust(), &absolute) {
            (true, Some(dir)) => by_path(dir),
            (true, None) => format!("{:?}", env!("CARGO_PKG_VERSION")),
            (false, Some(dir)) => in_a_makefile(dir),
            (false, None) => "TROCAR_DIRECTORY/sdk/c".into(),
        };
        // The lock file of trocar itself lies at the root of its sources.
        let lock = absolute.as_ref().filter(|_| self.is_rust()).map(|dir| dir.join("../../Cargo.lock"));
        Ok(Sdk { text, found: absolute.is_some(), lock: lock.filter(|lock| lock.is_file()) })
    }

    /// The part of the SDK that this template needs, where `dir` is `sdk/rust` or `sdk/c`.
    fn within(self, dir: &Path) -> Option<PathBuf> {
        let part = if self.is_rust() { "../rust" } else { "../c" };
        [dir.to_owned(), dir.join(part)].into_iter().find(|dir| self.is_sdk(dir))
    }

    fn is_sdk(self, dir: &Path) -> bool {
        if self.is_rust() {
            let manifest = fs::read_to_string(dir.join("Cargo.toml")).unwrap_or_default();
            manifest.contains("name = \"trocar-sdk\"")
        } else {
            ["trocar_plugin.hpp", "trocar_payloads.h"].iter().all(|header| dir.join(header).is_file())
        }
    }

    fn is_not_the_sdk(self, dir: &Path) -> Failure {
        let (missing, part) = if self.is_rust() {
            ("Cargo.toml there does not name trocar-sdk", "sdk/rust")
        } else {
            ("trocar_plugin.hpp and trocar_payloads.h are not there", "sdk/c")
        };
        Failure::usage(
            format!("{} is not the SDK: {missing}", dir.display()),
            format!("give the directory {part} of trocar's sources"),
        )
    }

    /// The warning when the sources are not beside this program, and what to do.
    pub(super) fn not_found(self, name: &str) -> String {
        if self.is_rust() {
            format!(
                "the SDK is not beside this program, so {name}/Cargo.toml asks for trocar-sdk {} from a registry. If cargo \
                 finds no package there, give it the sources: `trocar plugin new {name} --sdk TROCAR_DIRECTORY/sdk/rust`, or in \
                 Cargo.toml `trocar-sdk = {{ path = \"TROCAR_DIRECTORY/sdk/rust\" }}`",
                env!("CARGO_PKG_VERSION")
            )
        } else {
            format!(
                "trocar's C headers are not beside this program, so {name}/Makefile does not know where they are. Write the \
                 directory behind `SDK =` there, call `make SDK=TROCAR_DIRECTORY/sdk/c`, or begin with `--sdk \
                 TROCAR_DIRECTORY/sdk/c`"
            )
        }
    }
}

fn by_path(dir: &Path) -> String {
    // JSON and TOML basic strings escape alike what a path may hold.
    format!("{{ path = {} }}", serde_json::Value::from(dir.to_string_lossy()))
}

fn in_a_makefile(dir: &Path) -> String {
    dir.to_string_lossy().replace('$', "$$").replace('#', "\\#")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_file_below_sdk_templates_is_one_of_a_template() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sdk/templates");
        let names = |dir: &Path| {
            let entries = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
            let mut names: Vec<String> = entries.collect();
            names.sort();
            names
        };
        let mut templates: Vec<String> = Vec::new();
        for template in Template::value_variants() {
            let name = template.to_possible_value().unwrap().get_name().to_owned();
            let mut there = names(&root.join(&name));
            there.retain(|file| file != "src");
            there.extend(names(&root.join(&name).join("src")).into_iter().map(|file| format!("src/{file}")));
            let mut listed: Vec<String> =
                template.files().iter().map(|(path, _)| path.trim_start_matches('.').to_owned()).collect();
            there.sort();
            listed.sort();
            assert_eq!(there, listed, "{name}");
            templates.push(name);
        }
        templates.sort();
        assert_eq!(names(&root), templates);
    }

    #[test]
    fn a_directory_that_is_not_the_sdk_is_refused() {
        let temp = tempfile::tempdir().unwrap();
        for template in Template::value_variants() {
            assert!(template.sdk(Some(temp.path())).unwrap_err().message.contains("is not the SDK"));
        }
    }

    #[test]
    fn either_half_of_the_sdk_leads_to_the_one_that_is_needed() {
        let sdk = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sdk").canonicalize().unwrap();
        for template in Template::value_variants() {
            for half in ["rust", "c"] {
                let Sdk { text, found, lock } = template.sdk(Some(&sdk.join(half))).unwrap();
                let needed = sdk.join(if template.is_rust() { "rust" } else { "c" });
                assert!(found && text.contains(needed.to_str().unwrap()), "{template:?} {half}: {text}");
                assert_eq!(lock.is_some(), template.is_rust(), "{template:?}: {lock:?}");
            }
        }
    }

    #[test]
    fn a_path_means_the_same_in_a_makefile() {
        assert_eq!(in_a_makefile(Path::new("/a b/$c#1")), "/a b/$$c\\#1");
    }
}
