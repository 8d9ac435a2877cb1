//! `trocar run FILE`: a system file's one process with its own GCM, nothing kept afterwards.
//!
//! Invariant: the whole file is applied or nothing; a refusal points at the line it comes from.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use serde_json::json;
use trocar_model::Refusal;

use super::alike::folded;
use super::failure::{Done, Exit, Failure};
use super::named::FileArgs;
use super::session::Session;
use super::{check, hosting, logging, offline, out, session, units};
use trocar::gcm::ExecuteOptions;
use trocar::host::{Host, HostConfig, StopRequest};
use trocar::system_file::SystemFile;

/// Time that a whole system may take to come up.
const BRING_UP: Duration = Duration::from_secs(60);

const EXAMPLES: &str = "\
Example:
  trocar run system.json --set host/robot.seed=8 --seconds 10
Ctrl-C stops it, devices safe first; nothing is kept for the next run.";

/// Runs a system file: one host with a GCM of its own, and in it the components and connections of the file.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct RunArgs {
    #[command(flatten)]
    named: FileArgs,
    /// Address to listen on; port 0 takes a free one.
    #[arg(long, default_value = session::DEFAULT_GCM, value_name = "ADDR")]
    listen: String,
    /// End by itself after this many seconds.
    #[arg(long, value_name = "N")]
    seconds: Option<u64>,
    /// Print what would be done, and do nothing.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    port: hosting::PortArgs,
}

pub(super) async fn run(args: RunArgs, session: &Session) -> Done {
    if session.explicit_gcm().is_some() {
        return Err(Failure::usage(
            "`trocar run` has a GCM of its own",
            "leave --gcm out; --listen sets its address",
        ));
    }
    if args.dry_run {
        return check::dry_run(&args.named, check::Takes::One, session);
    }
    logging::install(log::LevelFilter::Warn);
    let file = args.named.read()?;
    let folder = args.named.system.file.parent().unwrap_or(Path::new(""));
    let config = config(&file, folder, args.named.plugins, args.listen)?;
    let config = HostConfig { rules: args.port.rules(), ..config };
    go_to(folder)?;
    let mut stop = StopRequest::listen();
    let mut host = config.start().await?;
    logging::to_readers(host.own_lines());
    let done = live(&mut host, &file, args.seconds, session, &mut stop).await;
    host.shutdown().await;
    done
}

/// Makes the file's folder the working directory, as `trocar up` does for its processes: paths in
/// configurations are relative to the file, too. Every other relative path was made absolute before.
fn go_to(folder: &Path) -> Result<(), Failure> {
    if folder.as_os_str().is_empty() {
        return Ok(());
    }
    let refused = |e| {
        let message = format!("{}: cannot be the working directory: {e}", folder.display());
        Failure::local("IO", message, "check the permissions of the system file's folder")
    };
    std::env::set_current_dir(folder).map_err(refused)
}

async fn live(
    host: &mut Host,
    file: &SystemFile,
    seconds: Option<u64>,
    session: &Session,
    stop: &mut StopRequest,
) -> Done {
    if !bring_up(host, file, stop).await? {
        return Ok(Exit::Interrupted);
    }
    say_running(host, file, session);
    let end = seconds.map_or(Duration::MAX, Duration::from_secs);
    if let Ok(ended) = tokio::time::timeout(end, host.until_asked_to_stop(stop)).await {
        ended?;
    }
    Ok(Exit::Ok)
}

/// The host a system file's one process asks for; relative paths are relative to `base`.
pub(super) fn config(
    file: &SystemFile,
    base: &Path,
    plugins: Vec<PathBuf>,
    listen: String,
) -> Result<HostConfig, Failure> {
    let process = file.single_process()?;
    let plugins = hosting::plugins_of(process, base, plugins);
    let plugins = plugins.into_iter().map(|dir| std::path::absolute(&dir).unwrap_or(dir)).collect();
    let trust = offline::trust(process, base)?;
    Ok(HostConfig {
        plugins,
        listen: Some(listen),
        trust,
        allow_exec: process.allow_exec,
        vet_with: std::env::current_exe().ok(),
        ..HostConfig::new(process.name.clone())
    })
}

/// Applies the whole file; a refusal is led back to its place in the file. False: asked to end meanwhile.
pub(super) async fn bring_up(
    host: &Host,
    file: &SystemFile,
    stop: &mut StopRequest,
) -> Result<bool, Failure> {
    let Some(gcm) = host.gcm() else { return Ok(false) };
    let identity = std::env::var("USER").unwrap_or_default();
    let options =
        ExecuteOptions { deadline: Some(Instant::now() + BRING_UP), identity, ..ExecuteOptions::default() };
    let executed = tokio::select! {
        executed = gcm.execute(file.requests(), options) => executed.map_err(|refusal| placed(file, &refusal))?,
        () = stop.asked() => return Ok(false),
    };
    let reports = executed.reports.iter();
    let warnings = reports.flat_map(|report| report.warnings.iter().map(|w| format!("{}: {w}", report.id)));
    folded(warnings).iter().for_each(|warning| logging::warn(warning));
    Ok(true)
}

fn placed(file: &SystemFile, refusal: &Refusal) -> Failure {
    let failure = Failure::from(refusal);
    match file.locate(refusal) {
        Some(place) => failure.at(&place),
        None => failure,
    }
}

fn say_running(host: &Host, file: &SystemFile, session: &Session) {
    let (components, connections) = (file.components.len(), file.connections.len());
    if session.json() {
        let line = json!({
            "listening": hosting::address(host),
            "components": components,
            "connections": connections,
            "viewer": hosting::viewer(&hosting::address(host)),
        });
        out::line(&line.to_string());
        return;
    }
    let addr = hosting::address(host);
    out::line(&format!(
        "{}, {}; listening on {addr}",
        units::count(components as u64, "component"),
        units::count(connections as u64, "connection")
    ));
    out::text(&hints(&addr, None));
}

/// A call by grpcurl, to paste; in two lines, so that a terminal of 80 columns shows all of it.
pub(super) fn invocation(addr: &str, command: &str) -> String {
    format!(
        "  grpcurl -plaintext -d '{{\"path\":\"{command}\"}}' \\\n    {addr} trocar.v1.InteractService/Invoke\n"
    )
}

/// Lines to paste. `command` is a read command to call, if one is known.
pub(super) fn hints(addr: &str, command: Option<&str>) -> String {
    let gcm = if addr == session::DEFAULT_GCM { String::new() } else { format!(" --gcm {addr}") };
    let viewer = hosting::viewer(addr);
    let mut text = format!(
        "  viewer {viewer}\n  trocar ls{gcm}\n  grpcurl -plaintext {addr} trocar.v1.GcmService/List\n"
    );
    if let Some(command) = command {
        text.push_str(&invocation(addr, command));
    }
    text.push_str("Ctrl-C stops it, devices safe first.\n");
    text
}
