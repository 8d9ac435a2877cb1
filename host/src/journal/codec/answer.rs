//! Requests and their answers, both ways.
//!
//! Invariant: an answer comes back with the same plan, so that the same request id gets the same words; the
//! changes of the plan lie beside it.

use trocar_lcm_api::Report;
use trocar_model::{Change, ComponentId, Refusal, Skipped, Target};
use trocar_proto::journal::v1 as wire;
use trocar_proto::v1;

use crate::control::convert::{refusal, refusal_info, report, report_in, unreadable};
use crate::gcm::{Answer, Asked, Executed};

pub(super) fn asked(a: &Asked) -> wire::Asked {
    let hash = if a.hash == [0; 32] { Vec::new() } else { a.hash.to_vec() };
    wire::Asked { identity: a.identity.clone(), request_id: a.request_id.clone(), hash, text: a.text.clone() }
}

pub(super) fn asked_in(a: wire::Asked) -> Result<Asked, Refusal> {
    let hash = match a.hash.as_slice() {
        [] => [0; 32],
        hash => hash.try_into().map_err(|_| unreadable("hash"))?,
    };
    Ok(Asked { identity: a.identity, request_id: a.request_id, hash, text: a.text })
}

pub(super) fn answer(answer: &Answer) -> wire::Answer {
    use wire::answer::Answer as A;
    let answer = match answer {
        Ok(executed) => A::Done(done(executed)),
        Err(refusal) => A::Refused(refusal_info(refusal)),
    };
    wire::Answer { answer: Some(answer) }
}

fn done(e: &Executed) -> wire::Done {
    let skipped = |s: &Skipped| v1::SkippedComponent { path: s.id.to_string(), why: s.why.clone() };
    let portless = |r: &Report| report(&Report { ports: None, ..r.clone() });
    let failed = |(target, why): &(Target, Refusal)| wire::NotStopped {
        target: target.to_string(),
        refused: Some(refusal_info(why)),
    };
    wire::Done {
        revision: e.revision,
        skipped: e.plan.skipped.iter().map(skipped).collect(),
        reports: e.reports.iter().map(portless).collect(),
        failed: e.failed.iter().map(failed).collect(),
        left: e.left.clone(),
    }
}

/// # Errors
/// A part is missing or of an unknown kind.
pub(super) fn answer_in(answer: wire::Answer, changes: Vec<Change>) -> Result<Answer, Refusal> {
    use wire::answer::Answer as A;
    Ok(match answer.answer.ok_or_else(|| unreadable("answer"))? {
        A::Done(done) => Ok(done_in(done, changes)?),
        A::Refused(info) => Err(refusal(&info)),
    })
}

fn done_in(d: wire::Done, changes: Vec<Change>) -> Result<Executed, Refusal> {
    let skipped = |s: v1::SkippedComponent| Ok(Skipped { id: ComponentId::parse(&s.path)?, why: s.why });
    let failed = |f: wire::NotStopped| {
        let why = refusal(&f.refused.ok_or_else(|| unreadable("refused"))?);
        Ok((Target::parse(&f.target)?, why))
    };
    let skipped = d.skipped.into_iter().map(skipped).collect::<Result<_, Refusal>>()?;
    Ok(Executed {
        revision: d.revision,
        plan: super::plan(changes, skipped),
        reports: d.reports.into_iter().map(report_in).collect::<Result<_, _>>()?,
        failed: d.failed.into_iter().map(failed).collect::<Result<_, Refusal>>()?,
        left: d.left,
    })
}
