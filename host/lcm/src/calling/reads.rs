//! Class reads from outside: plugin code on separate threads, so that a read that does not return blocks no
//! other thread.
//!
//! Invariant: each caller is answered by its deadline.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tokio::time::timeout_at;
use trocar_model::{MemberId, Refusal};

use super::super::books::Misuse;
use super::super::boundary::{Answer, ReadTarget};
use super::super::instance::Instance;
use super::super::reading::Late;
use super::GRACE;

/// One read request.
pub(super) struct Asked {
    pub(super) member: MemberId,
    /// Exact bytes of its argument's type.
    pub(super) arg: Vec<u8>,
    pub(super) ret_bytes: usize,
    pub(super) deadline_ns: u64,
}

/// Answers a class's read. A caller that leaves early does not end it: it is noted as late all the same.
///
/// # Errors
/// DEADLINE when it has not returned; COMMAND_FAILED at once where an earlier one has not; NoThread.
pub(super) async fn answer(server: Arc<Instance>, read: ReadTarget, asked: Asked) -> Result<Answer, Refusal> {
    let member = asked.member.clone();
    let bounded = tokio::spawn(bounded(server, read, asked));
    bounded.await.unwrap_or_else(|e| Err(panicked(&member, &e.to_string())))
}

fn panicked(member: &MemberId, why: &str) -> Refusal {
    Refusal::Internal { text: format!("reading {member} panicked: {why}") }
}

async fn bounded(server: Arc<Instance>, read: ReadTarget, asked: Asked) -> Result<Answer, Refusal> {
    let Asked { member, arg, ret_bytes, deadline_ns } = asked;
    let (reading, name) = (&server.reading, format!("{}/{}", member.port.port, member.member));
    let deadline =
        |may_still_run| Refusal::Deadline { member: member.clone(), after_ns: deadline_ns, may_still_run };
    let began = Instant::now();
    let until = began + Duration::from_nanos(deadline_ns);
    reading.refuse(&member, &name)?;
    let Ok(Ok(place)) = timeout_at(until.into(), reading.places.clone().acquire_owned()).await else {
        return Err(deadline(false));
    };
    // The former holder of the place may have been found late meanwhile.
    reading.refuse(&member, &name)?;
    let ticket = reading.ticket();
    let (tell, mut told) = oneshot::channel();
    let of = server.clone();
    let run = move || {
        // A failure means that the caller has given up.
        let _ = tell.send(read.answer(&arg, ret_bytes));
        of.reading.came_back(ticket);
        drop(place);
    };
    server
        .hub
        .readers
        .run(Box::new(run))
        .map_err(|e| Refusal::NoThread { id: server.id.clone(), why: e.to_string() })?;
    match timeout_at((until + GRACE).into(), &mut told).await {
        Ok(answer) => answer.map_err(|e| panicked(&member, &e.to_string())),
        Err(_) => {
            let late = Late { ticket, name: name.clone(), since: began };
            if let Some(answer) = reading.give_up(late, &mut told) {
                return Ok(answer);
            }
            server.books.failed(Misuse::ReadHung, name.as_bytes());
            Err(deadline(true))
        }
    }
}
