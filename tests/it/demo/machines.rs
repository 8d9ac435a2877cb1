//! The demo over three machines: namespaces of the network, made by its script.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use trocar_tests::{Built, repository, skip};

/// Reason why this machine gives a process no network of its own.
fn why_not() -> Option<String> {
    let mut tried = Command::new("unshare");
    let tried = tried.args(["--net", "ip", "link", "show"]).stdin(Stdio::null()).output();
    match tried {
        Ok(Output { status, .. }) if status.success() => None,
        Ok(Output { stderr, .. }) => Some(String::from_utf8_lossy(&stderr).trim().to_owned()),
        Err(e) => Some(format!("unshare: {e}")),
    }
}

#[test]
fn a_system_over_three_machines_is_up_by_one_command_and_leaves_nothing() {
    if let Some(why) = why_not() {
        return skip(&format!("no network of its own, which root and iproute2 give: {why}"));
    }
    let path = std::env::var("PATH").unwrap_or_default();
    let mut script = Command::new(repository().join("host/demo/three-machines"));
    script.args(["trocar", "ls", "--json"]).stdin(Stdio::null());
    script.env("PATH", format!("{}:{path}", Built::dir().display()));
    let ran = script.output().unwrap_or_else(|e| panic!("the script does not start: {e}"));
    let said = String::from_utf8_lossy(&ran.stdout);
    assert!(ran.status.success(), "{}: {said}{}", ran.status, String::from_utf8_lossy(&ran.stderr));
    let listed: Value = serde_json::from_str(&said).unwrap_or_else(|e| panic!("{e}: {said}"));
    let all = |key: &str| listed[key].as_array().cloned().unwrap_or_default();
    let idle: Vec<_> = all("components").into_iter().filter(|c| c["state"] != "ACTIVE").collect();
    assert!(idle.is_empty() && all("components").len() == 15, "{idle:?} of {listed}");
    let process = |end: &Value| end.as_str().and_then(|path| path.split('/').next()).map(str::to_owned);
    let (apart, inside): (Vec<_>, Vec<_>) =
        all("connections").into_iter().partition(|c| process(&c["client"]) != process(&c["server"]));
    assert!(apart.len() == 10 && apart.iter().all(|c| c["carrier"] == "net"), "{apart:?}");
    assert!(inside.iter().all(|c| c["carrier"] != "net"), "{inside:?}");
    for machine in ["switch", "console", "robot", "oct"] {
        let left = Path::new("/run/netns").join(format!("trocar-{machine}"));
        assert!(!left.exists(), "{} is left", left.display());
    }
}
