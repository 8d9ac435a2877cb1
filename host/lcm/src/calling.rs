//! Commands and reads called from outside: the argument checked, the way to the command, the outcome in
//! words.
//!
//! Invariant: no plugin code runs on the caller's own thread, and every call ends shortly after its deadline
//! at the latest, whatever the component does.

mod reads;

use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use trocar_lcm_api::{Invoke, Payload, Reply};
use trocar_model::{Arg, Command, MemberId, Ports, Refusal, Type, ValueError, check_range, decode, encode};
use trocar_plugin_api::abi::{
    DEADLINE, DISABLED, EXECUTED, INVALID_ARGUMENT, NOT_ACTIVE, Outcome, PEER_LOST, QUEUE_FULL, QUEUED,
    UNBOUND, WOULD_BLOCK,
};
use trocar_rt::os;

use super::boundary::{Answer, DEFAULT_DEADLINE_NS, FnBinding, REPLACED, Reader, within_ns};
use super::described::PortSet;
use super::instance::Instance;
use super::outside::{misfit, wrong_kind};
use super::passage;
use reads::Asked;

/// Time after its deadline at which a call from outside that still runs is left alone.
pub(super) const GRACE: Duration = Duration::from_millis(50);

/// Carries out one call; reads are answered from the published row.
///
/// # Errors
/// Each outcome of a call that is not EXECUTED or QUEUED, by its name.
pub(super) async fn invoke(instance: Arc<Instance>, call: Invoke) -> Result<Reply, Refusal> {
    let set = instance.described.now();
    invoke_by(instance, call, set).await
}

/// As `invoke`, by ports that were looked up already. If other ports replaced them before anything was
/// queued, nothing was executed: it looks again, within the deadline of the whole call.
pub(super) async fn invoke_by(
    instance: Arc<Instance>,
    call: Invoke,
    mut set: Arc<PortSet>,
) -> Result<Reply, Refusal> {
    let allowed_ns = within_ns(call.deadline_ns, DEFAULT_DEADLINE_NS);
    let until_ns = os::now_ns().saturating_add(allowed_ns);
    loop {
        let left_ns = until_ns.saturating_sub(os::now_ns());
        let done = attempt(&instance, &call, &set, left_ns.max(1)).await;
        let now = instance.described.now();
        let changed = !Arc::ptr_eq(&set, &now) && !instance.is_closed();
        match done {
            Err(Refusal::PeerLost { .. }) if changed && left_ns > 0 => set = now,
            Err(Refusal::Deadline { member, may_still_run, .. }) => {
                return Err(Refusal::Deadline { member, after_ns: allowed_ns, may_still_run });
            }
            done => return done,
        }
    }
}

/// Makes one attempt to call the command, by the ports of `set`.
async fn attempt(
    instance: &Arc<Instance>,
    call: &Invoke,
    set: &PortSet,
    deadline_ns: u64,
) -> Result<Reply, Refusal> {
    let (id, command) = find_command(&set.ports, &call.member)?;
    let arg = argument(&call.member, &command, &call.arg)?;
    let ret = command.ret.clone();
    let (send, member) = (call.send, call.member.clone());
    let unit = command.ret_unit.clone();
    let target = passage::target(&instance.core, set, id, &set.external, id, deadline_ns);
    let ret_bytes = ret.as_ref().map_or(0, Type::size);
    let answer = match target {
        // A command provided here leads nowhere else.
        FnBinding::Unbound | FnBinding::RemoteCommand(_) | FnBinding::RemoteRead(_) => Answer::unbound(),
        FnBinding::Read(read) => match read.from {
            // This read is the host's own code, which never waits: answered here.
            Reader::System(_) => read.answer(&arg, ret_bytes),
            Reader::Class(_) => {
                let member = member.clone();
                reads::answer(instance.clone(), read, Asked { member, arg, ret_bytes, deadline_ns }).await?
            }
        },
        FnBinding::Command(command) => {
            let calling =
                tokio::task::spawn_blocking(move || command.answer(&arg, ret_bytes, send, deadline_ns));
            // A queued call ends by itself. A call that runs in its own thread may not.
            let patience = Duration::from_nanos(deadline_ns).saturating_add(GRACE);
            match tokio::time::timeout(patience, calling).await {
                Ok(answer) => answer
                    .map_err(|e| Refusal::Internal { text: format!("calling {member} panicked: {e}") })?,
                Err(_) => {
                    return Err(Refusal::Deadline { member, after_ns: deadline_ns, may_still_run: true });
                }
            }
        }
    };
    match answer.outcome {
        EXECUTED | QUEUED => {}
        refused => return Err(refusal(instance, member, refused, answer, deadline_ns)),
    }
    let executed = answer.outcome == EXECUTED;
    let value = match (&ret, executed) {
        (Some(ty), true) => {
            Some(decode(ty, &answer.value).map_err(|e| misfit_of(instance, member.clone(), &e))?)
        }
        _ => None,
    };
    let age_ns = if answer.stamp_ns == 0 { 0 } else { os::now_ns().saturating_sub(answer.stamp_ns) };
    Ok(Reply {
        executed,
        value,
        encoded: if executed { answer.value } else { Vec::new() },
        stamp_ns: answer.stamp_ns,
        age_ns,
        unit,
    })
}

fn misfit_of(instance: &Instance, member: MemberId, e: &ValueError) -> Refusal {
    Refusal::CommandFailed { member, text: misfit(instance, e) }
}

fn refusal(
    instance: &Instance,
    member: MemberId,
    outcome: Outcome,
    answer: Answer,
    deadline_ns: u64,
) -> Refusal {
    match outcome {
        UNBOUND => Refusal::Unbound { member },
        DISABLED => Refusal::Disabled { member },
        NOT_ACTIVE => Refusal::NotActive { member, state: instance.state() },
        WOULD_BLOCK => Refusal::WouldBlock { member },
        QUEUE_FULL if answer.text == REPLACED => Refusal::Replaced { member },
        QUEUE_FULL => Refusal::QueueFull {
            member,
            depth: instance.described.now().external.mailbox.stats().depth as usize,
        },
        DEADLINE => Refusal::Deadline { member, after_ns: deadline_ns, may_still_run: answer.may_still_run },
        PEER_LOST => Refusal::PeerLost { member },
        INVALID_ARGUMENT => {
            Refusal::ArgumentInvalid { what: member.to_string(), why: answer.text, field: "json".into() }
        }
        _ => Refusal::CommandFailed { member, text: answer.text },
    }
}

/// The command a member names, with its id.
fn find_command(ports: &Ports, member: &MemberId) -> Result<(usize, Command), Refusal> {
    let port = member.port.port.as_str();
    let Some(interface) = ports.provided.iter().position(|p| p.name == port) else {
        return Err(Refusal::InterfaceNotFound {
            port: member.port.clone(),
            known: ports.provided.iter().map(|p| p.name.clone()).collect(),
        });
    };
    let commands = &ports.provided[interface].commands;
    let events = &ports.provided[interface].events;
    match commands.iter().position(|c| c.name == member.member.as_str()) {
        None if events.iter().any(|e| e.name == member.member.as_str()) => {
            Err(wrong_kind(member, "an event".to_owned(), "a command"))
        }
        Some(i) => Ok((ports.first_command(interface) + i, commands[i].clone())),
        None => Err(Refusal::MemberNotFound {
            member: member.clone(),
            known: commands.iter().map(|c| c.name.clone()).collect(),
        }),
    }
}

/// Returns the argument as exact bytes of the command's type, within its declared range.
fn argument(member: &MemberId, command: &Command, given: &Payload) -> Result<Vec<u8>, Refusal> {
    let invalid =
        |why: String| Refusal::ArgumentInvalid { what: member.to_string(), why, field: "json".into() };
    let Some(arg) = &command.arg else {
        return match given {
            Payload::None | Payload::Json(Value::Null) => Ok(Vec::new()),
            Payload::Encoded(bytes) if bytes.is_empty() => Ok(Vec::new()),
            _ => Err(invalid(format!("{} takes no argument", command.name))),
        };
    };
    let checked = |value: &Value| check_range(arg, value).map_err(&invalid);
    match given {
        Payload::None => Err(invalid(missing(command, arg))),
        Payload::Json(value) => {
            checked(value)?;
            encode(&arg.ty, value).map_err(|e| invalid(e.to_string()))
        }
        Payload::Encoded(bytes) => {
            let value = decode(&arg.ty, bytes).map_err(|e| invalid(e.to_string()))?;
            checked(&value)?;
            Ok(bytes.clone())
        }
    }
}

fn missing(command: &Command, arg: &Arg) -> String {
    let unit = if arg.unit.is_empty() { String::new() } else { format!(" in {}", arg.unit) };
    let name = if arg.name.is_empty() { String::new() } else { format!(" {}", arg.name) };
    format!("{} needs an argument{name}: {}{unit}", command.name, arg.ty.title())
}
