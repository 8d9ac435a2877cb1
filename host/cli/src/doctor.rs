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
pub(super) struct DoctorArgs {
    /// Print a systemd unit for `trocar agent` instead, with the rights that real-time components need.
    #[arg(long)]
    unit: bool,
}

/// Returns the unit of an agent for the user who asks.
fn unit() -> String {
    let program = std::env::current_exe().map_or_else(|_| "trocar".into(), |path| path.display().to_string());
    let user = std::env::var("USER").ok().filter(|user| !user.is_empty()).unwrap_or_else(|| "root".into());
    format!(
        "# /etc/systemd/system/trocar-agent.service; then: systemctl enable --now trocar-agent\n\
         [Unit]\n\
         Description=trocar agent: processes of systems of other machines\n\
         Wants=network-online.target\n\
         After=network-online.target\n\
         # Its address may come later than it does.\n\
         StartLimitIntervalSec=0\n\
         \n\
         [Service]\n\
         User={user}\n\
         # The address of this machine, and the file that `trocar ca issue NAME --role host` made for it.\n\
         ExecStart={program} agent --listen-tls ADDRESS:50550 --identity FILE\n\
         Restart=always\n\
         RestartSec=1\n\
         # Its processes end by themselves, devices safe first, also where it was killed.\n\
         KillMode=process\n\
         TimeoutStopSec=30\n\
         LimitRTPRIO=99\n\
         LimitMEMLOCK=infinity\n\
         LimitNOFILE=65536\n\
         \n\
         [Install]\n\
         WantedBy=multi-user.target\n"
    )
}

pub(super) fn run(args: &DoctorArgs, session: &Session) -> Done {
    if args.unit {
        out::text(&unit());
        return Ok(Exit::Ok);
    }
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
