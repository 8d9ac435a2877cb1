//! Options of a request, and its answer.

use std::time::{Duration, Instant};

use trocar_lcm_api::{Report, clock};
use trocar_model::{Plan, Refusal, Skipped, Target};

use super::text;

/// Time a request gets when it names no deadline.
const WITHIN: Duration = Duration::from_secs(5);

/// Options of one execution.
#[derive(Clone, Debug, Default)]
pub struct ExecuteOptions {
    pub validate_only: bool,
    /// Same id, same answer; empty = none.
    pub request_id: String,
    pub expected_revision: Option<u64>,
    /// Deadline of the whole request; after it all done changes are undone. Unset: 5 s from now.
    pub deadline: Option<Instant>,
    /// Caller's identity, for the audit line.
    pub identity: String,
}

impl ExecuteOptions {
    pub(super) fn until(&self) -> Instant {
        self.deadline.unwrap_or_else(|| clock::now() + WITHIN)
    }
}

/// Result of an accepted request.
#[derive(Clone, Default)]
pub struct Executed {
    pub revision: u64,
    pub plan: Plan,
    pub reports: Vec<Report>,
    /// Targets of a Stop that could not be stopped; the others are.
    pub failed: Vec<(Target, Refusal)>,
    /// Differences from a system file that no request ends, and who can end them.
    pub left: Vec<String>,
}

impl Executed {
    pub fn skipped(&self) -> &[Skipped] {
        &self.plan.skipped
    }
}

/// Prints one line per change; whole components would be pages.
impl std::fmt::Debug for Executed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let warnings: Vec<&String> = self.reports.iter().flat_map(|r| &r.warnings).collect();
        f.debug_struct("Executed")
            .field("revision", &self.revision)
            .field("plan", &text::lines(&self.plan))
            .field("skipped", &self.plan.skipped)
            .field("failed", &self.failed)
            .field("warnings", &warnings)
            .finish()
    }
}

/// Answer to a request.
pub type Answer = Result<Executed, Refusal>;
