//! Every template of `trocar plugin new`: begun, built, tested and run by the commands that are printed.
//!
//! Promise: each template is a plugin as it is, and a new one cannot be forgotten here.

use super::*;

macro_rules! templates {
    ($($template:ident)+) => {
        const TEMPLATES: &[&str] = &[$(stringify!($template)),+];
        $(#[test]
        fn $template() {
            runs(stringify!($template));
        })+
    };
}
templates! { filter source device arm cpp c }

#[test]
fn every_template_of_the_sdk_is_run_here_and_named_by_the_help_and_the_guide() {
    let entries = fs::read_dir(repository().join("sdk/templates")).unwrap();
    let mut there: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    there.sort();
    let mut run = TEMPLATES.to_vec();
    run.sort_unstable();
    assert_eq!(there, run);
    let guide = fs::read_to_string(repository().join("docs/PLUGIN_GUIDE.md")).unwrap();
    let help = Trocar::new(&World::new()).run(&["plugin", "new", "--help"]).ends_with(0).stdout;
    for template in TEMPLATES {
        assert!(help.contains(&format!("- {template}:")), "{template}: {help}");
        assert!(guide.contains(&format!("| `{template}` |")), "the guide has no row for {template}");
    }
}

/// A plugin of the template, from `trocar plugin new` to values that come out of its component in a host.
fn runs(template: &str) {
    let world = World::new();
    // Projects share a target directory, also with the guide's own, my-filter.
    let name = format!("begun-{template}");
    let new = ["plugin", "new", &name, "--template", template];
    let printed = Trocar::new(&world).run(&new).ends_with(0).stdout;
    let file = built(&world.path(&name), &printed);
    let path = file.display().to_string();
    Trocar::new(&world).run(&["plugin", "check", &path]).ends_with(0).says(&name);

    world.drop_in(&file);
    let host = HostProcess::start(&world);
    let (grpc, trocar) = (host.grpcurl(), Trocar::at(&world, host.address()));
    let class = grpc.await_class("host", &name.replace('-', "_"));
    grpc.create("host/f", &class, json!({}));
    connect_what_it_requires(&world, &host);
    trocar.run(&["start", "host/f"]).ends_with(0);
    let ports = grpc.ok("GcmService/Describe", json!({ "path": "host/f" }))["ports"].clone();
    let outputs = ports["outputs"].as_array().cloned().unwrap_or_default();
    // Taps belong to every component.
    let own = outputs.iter().filter_map(|o| o["name"].as_str()).filter(|o| !o.starts_with("tap_"));
    let mut seen = 0;
    for output in own {
        let echoed = trocar.run(&["echo", &format!("host/f/{output}"), "-n", "2"]).ends_with(0);
        assert!(echoed.stdout.lines().count() >= 2, "{output}: {echoed:#?}");
        seen += 1;
    }
    assert!(seen > 0, "{template} has no output: {ports}");
    if template == "arm" {
        moves(&path, &trocar);
    }
}

/// The library, after the steps that `trocar plugin new` prints: `cd`, commands, and where it is copied from.
fn built(project: &Path, printed: &str) -> PathBuf {
    let steps = printed.lines().filter_map(|line| line.strip_prefix("  "));
    let mut target = project.join("target");
    for step in steps {
        let words: Vec<&str> = step.split_whitespace().collect();
        match words.as_slice() {
            ["cd", name] => assert!(project.ends_with(name), "{step}"),
            ["cargo", args @ ..] => target = cargo(project, args),
            ["make", args @ ..] => make(project, args),
            ["cp", file, ..] => {
                let file = Path::new(file);
                return file.strip_prefix("target").map_or(project.join(file), |file| target.join(file));
            }
            _ => panic!("`trocar plugin new` prints a step that this test cannot follow: {step}"),
        }
    }
    panic!("`trocar plugin new` does not print where the library is:\n{printed}");
}

fn make(project: &Path, args: &[&str]) {
    let output = Command::new("make")
        .args(args)
        .arg(format!("TROCAR={}", Built::trocar().display()))
        .current_dir(project)
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|e| panic!("cannot start make, which C and C++ templates are built with: {e}"));
    let said = [output.stdout, output.stderr].map(|said| String::from_utf8_lossy(&said).into_owned());
    assert!(output.status.success(), "make {args:?}:\n{}", said.concat());
}

/// The arm is one by its contract, and goes where it is sent.
fn moves(file: &str, trocar: &Trocar) {
    trocar.run(&["plugin", "check", file, "--as", "arm"]).ends_with(0);
    let goal = r#"{"position": [0.004, 0, 0]}"#;
    trocar.run(&["call", "host/f/arm/move_jp", goal]).ends_with(1).says("enable");
    for word in ["enable", "home"] {
        trocar.run(&["call", "host/f/arm/state_command", &format!("{word:?}")]).ends_with(0);
    }
    trocar.run(&["call", "host/f/arm/move_jp", goal]).ends_with(0);
    eventually("the arm is where it was sent", || {
        let at = trocar.run(&["call", "host/f/arm/measured_cp", "--json"]).ends_with(0).stdout;
        let there = at.contains("0.004") || at.contains("0.0039999");
        if there { Ok(()) } else { Err(at) }
    });
}
