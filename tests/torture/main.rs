//! Faults on real processes: `torture [--seed N] [--gate | --times | --full] [--json] [--list] [ROW…]`.
//!
//! Invariant: a row passes only by what was seen; each bound in time is widened by the lateness of a control
//! run on the same machine, and by nothing else; with `--gate` none is judged. What was not run is said.
#![forbid(unsafe_code)]

mod asking;
mod book;
mod bystander;
mod churn;
mod clock;
mod files;
mod invariants;
mod journal;
mod json;
mod linear;
mod moments;
mod procfs;
mod program;
mod report;
mod rig;
mod rows;
mod rpc;
mod run;
mod site;
mod watching;
mod world;

use std::process::ExitCode;

use run::{Run, When};

const USAGE: &str = "torture [--seed N] [--gate | --times | --full] [--json] [--list] [ROW…]
  --seed N   the same moments as in that run
  --gate     judges no durations, and runs no row that claims nothing else: for a machine that does something else, too
  --times    judges durations, too; so it is without any of the three
  --full     the same with the counts of the acceptance, instead of a short selection
  --exact    what follows are names as in the lines `test torture::ROW ... ok`
  --json     one object on standard output instead of the table
  --list     the rows there are
TROCAR_BIN_DIR names the directory of the built program and plugins.";

fn main() -> ExitCode {
    let mut run = Run::default();
    let (mut wanted, mut json, mut exact) = (Vec::new(), false, false);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--seed" => match args.next().and_then(|n| n.parse().ok()) {
                Some(seed) => run.seed = seed,
                None => return wrong("--seed wants a number"),
            },
            "--full" => run.full = true,
            "--gate" => run.gate = true,
            "--times" => run.gate = false,
            "--exact" => exact = true,
            "--json" => json = true,
            "--list" => return list(),
            "--help" | "-h" => {
                println!("{USAGE}");
                return ExitCode::SUCCESS;
            }
            name => match name.strip_prefix("torture::").filter(|_| exact).unwrap_or(name) {
                name if rows::named(name) => wanted.push(name.to_owned()),
                other => return wrong(&format!("there is no row {other}; --list names them")),
            },
        }
    }
    if exact && wanted.is_empty() {
        return wrong("--exact wants names");
    }
    eprintln!("torture: seed {}{}", run.seed, if run.full { ", full" } else { "" });
    let (chosen, left): (Vec<_>, Vec<_>) = rows::all().into_iter().partition(|row| match wanted.is_empty() {
        true => run.has(row),
        false => wanted.iter().any(|name| name == row.name),
    });
    let carried_out = |row: &_| {
        let book = run.row(row);
        // One object is all that programs are given.
        if json {
            eprintln!("{}", report::line(&book));
        } else {
            println!("{}", report::line(&book));
        }
        book
    };
    let books: Vec<_> = chosen.into_iter().map(carried_out).collect();
    if json {
        println!("{}", report::json(&run, &books, &left));
    } else {
        print!("{}", report::table(&run, &books, &left));
    }
    if books.iter().all(book::Book::holds) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn list() -> ExitCode {
    for row in rows::all() {
        println!(
            "{:<12} {}{}",
            row.name,
            row.fault,
            match row.when {
                When::Gate => "",
                When::Times => " (not with --gate)",
                When::Full => " (only with --full or by name)",
            }
        );
    }
    ExitCode::SUCCESS
}

fn wrong(why: &str) -> ExitCode {
    eprintln!("torture: {why}\n{USAGE}");
    ExitCode::from(2)
}
