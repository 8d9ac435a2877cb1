//! `trocar plugin new NAME`: begins a plugin that builds, tests and loads as it is.
//!
//! Invariant: nothing that exists is touched; either the whole directory is written or nothing is.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use super::failure::{Done, Exit, Failure};
use super::out;
use super::session::Session;

/// Begins a new plugin in a new directory.
#[derive(Args, Debug)]
pub(super) struct NewArgs {
    /// Its name: small letters, digits, dashes; also the directory.
    name: String,
    /// What to begin with.
    #[arg(long, value_enum, default_value_t = Template::Filter)]
    template: Template,
    /// Directory of the SDK [default: found beside this program, else the published version].
    #[arg(long, value_name = "DIR")]
    sdk: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Template {
    /// A component with an input, an output, a configuration and a command.
    Filter,
}

/// The files of a template: path and text with `{{…}}` places.
const FILTER: &[(&str, &str)] = &[
    ("Cargo.toml", include_str!("../../../sdk/templates/filter/Cargo.toml")),
    (".gitignore", include_str!("../../../sdk/templates/filter/gitignore")),
    ("src/lib.rs", include_str!("../../../sdk/templates/filter/src/lib.rs")),
];

pub(super) fn run(args: &NewArgs, session: &Session) -> Done {
    check_name(&args.name)?;
    let dir = Path::new(&args.name);
    if dir.exists() {
        return Err(Failure::local(
            "EXISTS",
            format!("{} exists already", dir.display()),
            "choose another name, or go to another directory",
        ));
    }
    let (sdk, found) = sdk_dependency(args.sdk.as_deref())?;
    let files = match args.template {
        Template::Filter => FILTER,
    };
    write(dir, files, &args.name, &sdk).map_err(|e| {
        // Half a plugin helps nobody.
        let _ = fs::remove_dir_all(dir);
        Failure::local(
            "IO",
            format!("cannot write {}: {e}", dir.display()),
            "check the permissions and the free space",
        )
    })?;
    if session.json() {
        return session.print_json(&json!({ "directory": dir, "sdk": sdk, "sdk_found": found }));
    }
    if !found {
        out::complain("warning", &not_found(&args.name));
    }
    let library = args.name.replace('-', "_");
    out::text(&format!(
        "{0}/ is ready. Next:\n  cd {0}\n  cargo test\n  cargo build --release\n  \
         cp target/release/lib{library}.so DIR/     # a plugin directory of a running host\n",
        args.name
    ));
    Ok(Exit::Ok)
}

fn write(dir: &Path, files: &[(&str, &str)], name: &str, sdk: &str) -> std::io::Result<()> {
    for (path, text) in files {
        let path = dir.join(path);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        fs::write(path, fill(text, name, sdk))?;
    }
    Ok(())
}

fn fill(text: &str, name: &str, sdk: &str) -> String {
    text.replace("{{name}}", name)
        .replace("{{crate}}", &name.replace('-', "_"))
        .replace("{{Name}}", &camel(name))
        .replace("{{sdk}}", sdk)
}

fn camel(name: &str) -> String {
    let capital = |part: &str| {
        let mut letters = part.chars();
        letters.next().map(|c| c.to_ascii_uppercase()).into_iter().chain(letters).collect::<String>()
    };
    name.split('-').map(capital).collect()
}

/// The names Rust would trip over as crate names.
const RESERVED: &[&str] = &["test", "core", "std", "alloc", "self", "super", "crate", "trocar", "trocar-sdk"];

fn check_name(name: &str) -> Result<(), Failure> {
    let first = name.chars().next().is_some_and(|c| c.is_ascii_lowercase());
    let rest = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
    let dashes = !name.ends_with('-') && !name.contains("--");
    if !first || !rest || !dashes || name.len() > 40 {
        return Err(Failure::usage(
            format!("{name:?} cannot be a plugin's name"),
            "begin with a small letter; then small letters, digits and single dashes, up to 40 characters: my-filter",
        ));
    }
    if RESERVED.contains(&name) {
        return Err(Failure::usage(
            format!("{name:?} is taken by Rust or trocar itself"),
            "add a word: my-filter",
        ));
    }
    Ok(())
}

/// What to do when the sources are not where this program lies.
fn not_found(name: &str) -> String {
    format!(
        "the SDK is not beside this program, so {name}/Cargo.toml asks for trocar-sdk {} from a registry. If cargo finds no \
         package there, give it the sources: `trocar plugin new {name} --sdk TROCAR_DIRECTORY/sdk/rust`, or in Cargo.toml \
         `trocar-sdk = {{ path = \"TROCAR_DIRECTORY/sdk/rust\" }}`",
        env!("CARGO_PKG_VERSION")
    )
}

/// What stands behind `trocar-sdk =` in the new Cargo.toml, and whether sources were found for it.
fn sdk_dependency(asked: Option<&Path>) -> Result<(String, bool), Failure> {
    if let Some(dir) = asked {
        let manifest = dir.join("Cargo.toml");
        let text = fs::read_to_string(&manifest).unwrap_or_default();
        if !text.contains("name = \"trocar-sdk\"") {
            return Err(Failure::usage(
                format!("{} is not the SDK: {} does not name trocar-sdk", dir.display(), manifest.display()),
                "give the directory sdk/rust of trocar's sources",
            ));
        }
        return Ok((by_path(dir), true));
    }
    let found = std::env::current_exe().ok().and_then(|exe| {
        let repo = exe.ancestors().find(|a| a.join("sdk/rust/Cargo.toml").is_file())?;
        Some(repo.join("sdk/rust"))
    });
    let published = || (format!("{:?}", env!("CARGO_PKG_VERSION")), false);
    Ok(found.map_or_else(published, |dir| (by_path(&dir), true)))
}

fn by_path(dir: &Path) -> String {
    let dir = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    // JSON and TOML basic strings escape alike what a path may hold.
    format!("{{ path = {} }}", serde_json::Value::from(dir.to_string_lossy()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn names_that_cargo_or_the_directory_would_refuse_are_refused_first() {
        for bad in ["", "My", "1st", "a_b", "a--b", "a-", "../x", "test"] {
            assert!(check_name(bad).is_err(), "{bad:?} was taken");
        }
        check_name("my-filter").unwrap();
    }

    #[test]
    fn places_are_filled_in() {
        let text = fill("{{name}} {{crate}} {{Name}} {{sdk}}", "my-filter", "\"0.1.0\"");
        assert_eq!(text, "my-filter my_filter MyFilter \"0.1.0\"");
    }

    #[test]
    fn no_place_of_the_template_is_left_open() {
        for (path, text) in FILTER {
            let filled = fill(text, "my-filter", "\"0.1.0\"");
            assert!(!filled.contains("{{"), "{path} still has an open place:\n{filled}");
        }
    }

    #[test]
    fn a_directory_that_is_not_the_sdk_is_refused() {
        let temp = tempfile::tempdir().unwrap();
        assert!(sdk_dependency(Some(temp.path())).unwrap_err().message.contains("is not the SDK"));
    }
}
