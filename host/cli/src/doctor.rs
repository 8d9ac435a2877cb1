//! `trocar doctor`: what this machine allows a host, and how to allow more.
//!
//! Invariant: it changes nothing; it asks this machine only, never a GCM.

use clap::Args;
use serde_json::json;

use super::failure::{Done, Exit};
use super::session::Session;
use super::table::Table;
use super::{out, style};
use trocar::doctor::{Finding, Verdict, judge, probe};

/// Says what this machine allows a host (priorities, locked memory, clock, …) and how to allow more.
#[derive(Args, Debug)]
pub(super) struct DoctorArgs {}

pub(super) fn run(_: &DoctorArgs, session: &Session) -> Done {
    let facts = probe();
    let findings = judge(&facts);
    let exit = if findings.iter().any(|f| f.verdict == Verdict::Bad) { Exit::Refused } else { Exit::Ok };
    if session.json() {
        let f = &facts.figures;
        session.print_json(&json!({
            "findings": findings.iter().map(|f| json!({
                "what": f.what,
                "verdict": f.verdict.word(),
                "found": f.found,
                "means": f.means,
                "allow": f.allow,
            })).collect::<Vec<_>>(),
            "clock_read_ns": f.clock_read_ns,
            "wake_p50_ns": f.wake_p50_ns,
            "wake_p99_ns": f.wake_p99_ns,
            "wake_max_ns": f.wake_max_ns,
        }))?;
        return Ok(exit);
    }
    out::text(&people(&findings, style::stdout()));
    Ok(exit)
}

fn people(findings: &[Finding], colour: bool) -> String {
    let mut table = Table::new(&["WHAT", "VERDICT", "FOUND"]);
    for finding in findings {
        let paint = match finding.verdict {
            Verdict::Fine => style::GOOD,
            Verdict::Limited => style::WARN,
            Verdict::Bad => style::BAD,
        };
        table.styled([
            (finding.what.to_owned(), style::PLAIN),
            (finding.verdict.word().to_owned(), paint),
            (finding.found.clone(), style::PLAIN),
        ]);
    }
    let mut text = table.render(0, colour);
    let complaints: Vec<&Finding> = findings.iter().filter(|f| f.verdict != Verdict::Fine).collect();
    for finding in &complaints {
        text.push_str(&format!(
            "\n{}: {}\n  to allow more: {}\n",
            finding.what, finding.means, finding.allow
        ));
    }
    if complaints.is_empty() {
        text.push_str("\nnothing to improve\n");
    }
    text
}
