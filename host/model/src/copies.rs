//! Copies by name: a sample is made from one whose fields lie elsewhere.
//!
//! Invariant: every run lies inside both types, and a plan is short enough for a step ([`MAX_COPIES`]).

use crate::Type;
use crate::types::agree;

/// A run of bytes to copy from the server's sample into the client's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CopyRun {
    /// Offset in the server's sample, bytes.
    pub from: usize,
    /// Offset in the client's sample, bytes.
    pub to: usize,
    /// Bytes.
    pub len: usize,
}

impl Type {
    /// Tells whether a client of this type can be fed by name from `server`'s: see [`Type::copy_plan`].
    pub fn can_adapt(&self, server: &Type) -> bool {
        self.copy_plan(server).is_some()
    }

    /// Returns the way to fill a value of this type from one of `server`'s by name: every field exists there
    /// with the same kind, unit and frame (as in [`Type::accepts`]), only elsewhere; so in nested structs and
    /// in the items of arrays and lists of one length. Neighbouring runs are joined. `None` = impossible, or
    /// more than [`MAX_COPIES`] runs.
    pub fn copy_plan(&self, server: &Type) -> Option<Vec<CopyRun>> {
        self.plan(server).ok()
    }

    /// Tells whether the number of runs prevents a [`Type::copy_plan`], perhaps beside other reasons.
    pub fn is_scattered(&self, server: &Type) -> bool {
        self.plan(server) == Err(NoPlan::TooMany)
    }

    fn plan(&self, server: &Type) -> Result<Vec<CopyRun>, NoPlan> {
        let mut plan = Vec::new();
        copies(self, server, &mut plan)?;
        Ok(plan)
    }
}

/// Most runs a copy plan may have; beyond it a by-name copy is no longer cheap enough for a step.
pub const MAX_COPIES: usize = 1024;

/// Most items of an array that are looked at one by one: as many as a sample may have bytes.
const MAX_ITEMS: usize = 1 << 16;

/// Reason why there is no copy plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NoPlan {
    /// A part is missing there, or of another kind, unit, frame or length.
    Differs,
    TooMany,
}

/// Appends the runs that fill a client's value at 0 from a server's at 0.
fn copies(client: &Type, server: &Type, plan: &mut Vec<CopyRun>) -> Result<(), NoPlan> {
    match (client, server) {
        _ if client.accepts(server) => append(plan, CopyRun { from: 0, to: 0, len: client.size() }),
        (Type::Array { item: a, n }, Type::Array { item: b, n: m }) if n == m => {
            item_copies(a, b, *n, 0, plan)
        }
        (Type::List { item: a, n }, Type::List { item: b, n: m }) if n == m => {
            append(plan, CopyRun { from: 0, to: 0, len: LIST_HEAD })?;
            item_copies(a, b, *n, LIST_HEAD, plan)
        }
        (Type::Struct(a), Type::Struct(b)) => {
            for f in &a.fields {
                let g = b.fields.iter().find(|g| g.name == f.name && agree(f, g)).ok_or(NoPlan::Differs)?;
                let mut field = Vec::new();
                copies(&f.ty, &g.ty, &mut field)?;
                for run in field {
                    append(plan, run.moved(g.at, f.at)?)?;
                }
            }
            Ok(())
        }
        _ => Err(NoPlan::Differs),
    }
}

/// Bytes of a list before its items.
const LIST_HEAD: usize = 8;

/// Plans the copies of `n` items that lie one after the other, from byte `at`; of a list also of those it
/// does not hold.
fn item_copies(a: &Type, b: &Type, n: usize, at: usize, plan: &mut Vec<CopyRun>) -> Result<(), NoPlan> {
    let mut item = Vec::new();
    copies(a, b, &mut item)?;
    // Items without bytes may be any number.
    item.retain(|run| run.len > 0);
    if item.is_empty() {
        return Ok(());
    }
    if n > MAX_ITEMS {
        return Err(NoPlan::TooMany);
    }
    for i in 0..n {
        let place = |size: usize| i.checked_mul(size).and_then(|far| far.checked_add(at));
        let (from, to) = place(b.size()).zip(place(a.size())).ok_or(NoPlan::Differs)?;
        for run in &item {
            append(plan, run.moved(from, to)?)?;
        }
    }
    Ok(())
}

fn append(plan: &mut Vec<CopyRun>, run: CopyRun) -> Result<(), NoPlan> {
    match plan.last_mut() {
        Some(last) if last.from + last.len == run.from && last.to + last.len == run.to => last.len += run.len,
        _ => plan.push(run),
    }
    if plan.len() <= MAX_COPIES { Ok(()) } else { Err(NoPlan::TooMany) }
}

impl CopyRun {
    /// Returns the same run so many bytes further on; an error beyond the largest number of bytes.
    fn moved(self, from: usize, to: usize) -> Result<CopyRun, NoPlan> {
        let moved = |at: usize, by: usize| at.checked_add(by).filter(|at| at.checked_add(self.len).is_some());
        let (from, to) = moved(self.from, from).zip(moved(self.to, to)).ok_or(NoPlan::Differs)?;
        Ok(CopyRun { from, to, ..self })
    }
}
