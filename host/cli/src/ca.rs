//! `trocar ca`: the authority of a system, by which processes and people of different machines know each
//! other.
//!
//! Invariant: asks no GCM; keys are written only to files that their user alone reads.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde_json::{Value, json};
use trocar_net::{Authority, AuthorityError, Issued, Role, Wish};

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::table::Table;
use super::{out, style};
use trocar::host::state_home;

const EXAMPLES: &str = "\
Examples:
  trocar ca init
  trocar ca issue or1 --role gcm --address 10.0.0.1
  trocar ca issue cart --role host --process cart
  trocar ca issue anna --role operator
      One file for each, with key, certificate and that of the authority: copy it to where it is used.
  trocar gcm --identity or1.pem --listen-tls 10.0.0.1:50552 --revoked $(trocar ca revoked)
  trocar host --identity cart.pem --gcm https://10.0.0.1:50552 --name cart        # on another machine
  trocar ls --identity anna.pem --gcm https://10.0.0.1:50552
  grpcurl -cacert anna.pem -cert anna.pem -key anna.pem 10.0.0.1:50552 trocar.v1.GcmService/List
  trocar ca revoke anna
      Ends what anna has open within a tenth of a second.";

/// Makes certificates by which other machines know a process or a person, and takes them back.
///
/// Everything lies in one directory of yours. Certificates of one authority believe each other, and none of
/// another one's.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct CaArgs {
    /// Directory of the authority [default: trocar/authority.ca in the user's state directory].
    #[arg(long, value_name = "DIR", global = true)]
    dir: Option<PathBuf>,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand, Debug)]
enum Verb {
    /// Makes an authority.
    Init,
    /// Issues a certificate, with its key.
    Issue(IssueArgs),
    /// Takes the valid certificates of a name back, or the one of a number.
    Revoke {
        /// The name, or the number that `trocar ca ls` shows.
        what: String,
    },
    /// Lists what was issued.
    Ls,
    /// Prints the file of the revoked certificates, for --revoked.
    Revoked,
}

#[derive(Args, Debug)]
struct IssueArgs {
    /// Name of the holder, as audit and log will show it.
    name: String,
    /// Its rights: viewer looks; operator starts, stops, calls and configures; administrator changes
    /// everything; host is a process; gcm manages.
    #[arg(long)]
    role: Role,
    /// A process that a host may be, or a beginning of such names with a * behind it; may be given several
    /// times.
    #[arg(long, value_name = "NAME")]
    process: Vec<String>,
    /// Address or name under which browsers and grpcurl reach it; may be given several times.
    #[arg(long, value_name = "HOST")]
    address: Vec<String>,
    /// Days for which it is valid.
    #[arg(long, default_value_t = 30)]
    days: u32,
    /// File to write [default: NAME.pem].
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) fn run(args: CaArgs, session: &Session) -> Done {
    let dir = args.dir.unwrap_or_else(|| state_home().join("authority.ca"));
    match args.verb {
        Verb::Init => init(&dir, session),
        Verb::Issue(wish) => issue(&dir, wish, session),
        Verb::Revoke { what } => revoke(&dir, &what, session),
        Verb::Ls => list(&dir, session),
        Verb::Revoked => {
            let list = open(&dir)?.revoked_list();
            match session.json() {
                true => session.print_json(&json!({ "revoked": list })),
                false => said(&list.display().to_string()),
            }
        }
    }
}

fn said(line: &str) -> Done {
    out::line(line);
    Ok(Exit::Ok)
}

fn open(dir: &Path) -> Result<Authority, Failure> {
    Authority::open(dir).map_err(|e| failure(&e))
}

fn init(dir: &Path, session: &Session) -> Done {
    let authority = Authority::init(dir).map_err(|e| failure(&e))?;
    if session.json() {
        let files = json!({ "certificate": authority.certificate(), "revoked": authority.revoked_list() });
        return session.print_json(&files);
    }
    out::line(&format!("authority made in {}", dir.display()));
    out::line("  anybody who has that directory can issue anything: keep a copy of it in a safe place");
    said("  next: trocar ca issue NAME --role gcm --address HOST")
}

fn issue(dir: &Path, wish: IssueArgs, session: &Session) -> Done {
    let IssueArgs { name, role, process: processes, address: addresses, days, out } = wish;
    let out = out.unwrap_or_else(|| format!("{name}.pem").into());
    let wish = Wish { name, role, processes, addresses, days };
    let issued = open(dir)?.issue(&wish, &out).map_err(|e| failure(&e))?;
    if session.json() {
        let mut told = value(&issued);
        told["file"] = json!(out);
        return session.print_json(&told);
    }
    out::line(&format!("{} {} in {}, valid for {days} days", issued.role, issued.name, out.display()));
    said("  it holds a key: copy it only to where it is used, and let nobody else read it there")
}

fn revoke(dir: &Path, what: &str, session: &Session) -> Done {
    let gone = open(dir)?.revoke(what).map_err(|e| failure(&e))?;
    if session.json() {
        return session.print_json(&gone.iter().map(value).collect::<Vec<_>>());
    }
    for one in &gone {
        out::line(&format!("revoked: {} {} ({})", one.role, one.name, one.number));
    }
    said(
        "  programs that were started with --revoked end its connections at once; copy the list to other machines",
    )
}

fn list(dir: &Path, session: &Session) -> Done {
    let authority = open(dir)?;
    if session.json() {
        return session.print_json(&authority.issued().iter().map(value).collect::<Vec<_>>());
    }
    let now = seconds();
    let mut table = Table::new(&["NAME", "ROLE", "VALID", "PROCESSES", "ADDRESSES", "NUMBER"]);
    for one in authority.issued() {
        let valid = match one.revoked {
            Some(_) => "revoked".to_owned(),
            None if one.until <= now => "expired".to_owned(),
            None => format!("{} days", (one.until - now).div_euclid(86_400)),
        };
        let (processes, addresses) = (one.processes.join(" "), one.addresses.join(" "));
        table.row([one.name.clone(), one.role.clone(), valid, processes, addresses, one.number.clone()]);
    }
    let none = "nothing was issued yet: `trocar ca issue NAME --role operator`\n";
    out::text(&if table.is_empty() { none.to_owned() } else { table.render(0, style::stdout()) });
    Ok(Exit::Ok)
}

fn value(one: &Issued) -> Value {
    json!({
        "number": one.number,
        "name": one.name,
        "role": one.role,
        "processes": one.processes,
        "addresses": one.addresses,
        "until": one.until,
        "revoked": one.revoked,
    })
}

fn seconds() -> i64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    now.map_or(0, |now| i64::try_from(now.as_secs()).unwrap_or(i64::MAX))
}

fn failure(e: &AuthorityError) -> Failure {
    let help = match e {
        AuthorityError::Exists { .. } => {
            "go on with it: `trocar ca ls`; or name another directory: --dir DIR"
        }
        AuthorityError::Missing { .. } => "make one: `trocar ca init`; or name its directory: --dir DIR",
        AuthorityError::Unfit { .. } => "`trocar ca issue --help` shows examples",
        AuthorityError::Unknown { .. } => "`trocar ca ls` lists what was issued",
        AuthorityError::Broken { .. } => "see that the file is there, and that you may read and write it",
    };
    Failure::local("AUTHORITY", e.to_string(), help)
}
