//! `trocar call host/robot/arm/servo_jp '{"position": […]}'`.
//!
//! Invariant: the call always ends by its deadline.

use clap::Args;

use super::failure::{Done, Exit};
use super::session::Session;
use super::typed::json_value;
use super::{out, units};

/// Longest answer shown on one line, characters.
const ONE_LINE: usize = 100;

/// Calls a command: `trocar call host/robot/arm/measured_cp`.
#[derive(Args, Debug)]
pub(super) struct CallArgs {
    /// process/component/interface/command.
    path: String,
    /// The argument as JSON; left out for a command that takes none.
    #[arg(value_name = "JSON", allow_hyphen_values = true)]
    arg: Option<String>,
    /// How long to wait for the result, e.g. 500ms.
    #[arg(long, default_value = "1s", value_name = "TIME", value_parser = units::parse_time)]
    deadline: u64,
    /// Return as soon as the command is queued.
    #[arg(long)]
    send: bool,
}

pub(super) async fn run(args: CallArgs, session: &Session) -> Done {
    let arg = args.arg.as_deref().map(json_value).transpose()?;
    let reply = session.invoke(&args.path, arg.as_ref(), args.deadline, args.send).await?;
    if session.json() {
        return session.print_json(&reply);
    }
    let unit = if reply.unit.is_empty() { String::new() } else { format!(" {}", reply.unit) };
    match (&reply.value, reply.executed) {
        (Some(value), _) => {
            let value = out::without_padding(value);
            let short = value.to_string();
            let text = if short.len() > ONE_LINE { format!("{value:#}") } else { short };
            out::text(&format!("{}{unit}\n", out::lines(&text)));
        }
        (None, true) => out::line("executed"),
        (None, false) => out::line("queued"),
    }
    Ok(Exit::Ok)
}
