//! `trocar plugin new NAME`: begins a plugin that builds, tests and loads as it is.
//!
//! Invariant: nothing that exists is touched; either the whole directory is written or nothing is.

mod template;

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::failure::{Done, Exit, Failure};
use super::out;
use super::session::Session;
use template::{Sdk, Template};

/// Begins a new plugin in a new directory.
#[derive(Args, Debug)]
pub(super) struct NewArgs {
    /// Its name: small letters, digits, dashes; also the directory.
    name: String,
    /// What to begin with.
    #[arg(long, value_enum, default_value_t = Template::Filter)]
    template: Template,
    /// Directory of the SDK, sdk/rust or sdk/c of trocar's sources [default: found beside this program].
    #[arg(long, value_name = "DIR")]
    sdk: Option<PathBuf>,
}

pub(super) fn run(args: &NewArgs, session: &Session) -> Done {
    let template = args.template;
    check_name(&args.name, template.files())?;
    let dir = Path::new(&args.name);
    if dir.exists() {
        return Err(Failure::local(
            "EXISTS",
            format!("{} exists already", dir.display()),
            "choose another name, or go to another directory",
        ));
    }
    let sdk = template.sdk(args.sdk.as_deref())?;
    write(dir, template.files(), &args.name, &sdk).map_err(|e| {
        // Half a plugin is of no use.
        let _ = fs::remove_dir_all(dir);
        Failure::local(
            "IO",
            format!("cannot write {}: {e}", dir.display()),
            "check the permissions and the free space",
        )
    })?;
    if session.json() {
        return session.print_json(&json!({ "directory": dir, "sdk": sdk.text, "sdk_found": sdk.found }));
    }
    if !sdk.found {
        out::complain("warning", &template.not_found(&args.name));
    }
    out::text(&template.next_steps(&args.name));
    Ok(Exit::Ok)
}

fn write(dir: &Path, files: &[(&str, &str)], name: &str, sdk: &Sdk) -> std::io::Result<()> {
    for (path, text) in files {
        let path = dir.join(path);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        fs::write(path, fill(text, name, &sdk.text))?;
    }
    if let Some(lock) = &sdk.lock {
        fs::copy(lock, dir.join("Cargo.lock"))?;
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

/// Names of crates that would clash, and the words of Rust, C and C++: a name becomes an identifier in each.
const RESERVED: &str = "test core std alloc self super crate trocar trocar-sdk abstract alignas alignof and as asm \
    async auto await become bitand bitor bool box break case catch char class compl const constexpr \
    continue decltype default delete do double dyn else enum explicit export extern false final \
    float fn for friend gen goto if impl in inline int let long loop macro main match mod move mut \
    mutable namespace new noexcept not nullptr operator or override priv private protected pub \
    public ref register restrict return short signed sizeof static struct switch template this \
    thread-local throw trait true try type typedef typeid typename typeof union unsafe unsigned \
    unsized use using virtual void volatile where while xor yield";

fn check_name(name: &str, files: &[(&str, &str)]) -> Result<(), Failure> {
    let first = name.chars().next().is_some_and(|c| c.is_ascii_lowercase());
    let rest = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
    let dashes = !name.ends_with('-') && !name.contains("--");
    if !first || !rest || !dashes || name.len() > 40 {
        return Err(Failure::usage(
            format!("{name:?} cannot be a plugin's name"),
            "begin with a small letter; then small letters, digits and single dashes, up to 40 characters: my-filter",
        ));
    }
    if RESERVED.split_whitespace().any(|word| word == name) {
        return Err(Failure::usage(
            format!("{name:?} is taken by Rust, C, C++ or trocar itself"),
            "add a word: my-filter",
        ));
    }
    let class = camel(name);
    if files.iter().any(|(_, text)| has_word(text, &class)) {
        return Err(Failure::usage(
            format!("{name:?} makes a class {class}, and the template uses {class} for something else"),
            format!("add a word: my-{name}"),
        ));
    }
    Ok(())
}

/// The code of `text`, without its comments, has `word` as an identifier.
fn has_word(text: &str, word: &str) -> bool {
    let code = text.lines().filter(|line| !["//", "#", "*", "/*"].iter().any(|c| line.trim().starts_with(c)));
    code.flat_map(|line| line.split(|c: char| !c.is_alphanumeric() && c != '_')).any(|w| w == word)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use clap::ValueEnum;

    fn checked(name: &str) -> Result<(), Failure> {
        Template::value_variants().iter().try_for_each(|template| check_name(name, template.files()))
    }

    #[test]
    fn names_that_cargo_a_compiler_or_the_directory_would_refuse_are_refused_first() {
        for bad in ["", "My", "1st", "a_b", "a--b", "a-", "../x", "test", "int", "async", "namespace"] {
            assert!(checked(bad).is_err(), "{bad:?} was taken");
        }
        checked("my-filter").unwrap();
    }

    #[test]
    fn a_name_whose_class_the_template_uses_for_something_else_is_refused() {
        for (bad, template) in
            [("scalar", Template::Filter), ("component", Template::Cpp), ("drive", Template::Arm)]
        {
            let refused = check_name(bad, template.files()).unwrap_err();
            assert!(refused.message.contains(&camel(bad)), "{}", refused.message);
        }
        for good in ["filter", "source", "device", "arm", "cpp", "c", "sensor", "low-pass", "robot"] {
            checked(good).unwrap();
        }
    }

    #[test]
    fn places_are_filled_in() {
        let text = fill("{{name}} {{crate}} {{Name}} {{sdk}}", "my-filter", "\"0.1.0\"");
        assert_eq!(text, "my-filter my_filter MyFilter \"0.1.0\"");
    }

    #[test]
    fn no_place_of_a_template_is_left_open_and_each_has_all_of_them() {
        for template in Template::value_variants() {
            let mut used = Vec::new();
            for (path, text) in template.files() {
                let filled = fill(text, "my-filter", "\"0.1.0\"");
                assert!(!filled.contains("{{"), "{template:?} {path} still has an open place:\n{filled}");
                used.extend(text.split("{{").skip(1).filter_map(|rest| rest.split("}}").next()));
            }
            for place in ["name", "crate", "sdk"] {
                assert!(used.contains(&place), "{template:?} does not use the place {place}");
            }
        }
    }
}
