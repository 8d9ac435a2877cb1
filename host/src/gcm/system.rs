//! The system as a file: compared with one, and made as one says.
//!
//! Invariant: the compared system is the changed one: a change is refused when the graph has moved on since,
//! and compared anew.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use trocar_model::{ComponentId, Name, Refusal};

use super::answer::{Answer, ExecuteOptions, Executed};
use super::journal::Asked;
use super::{Gcm, audit};
use crate::system_file::{Difference, Running, SystemFile};

/// Comparisons of a system that others change meanwhile, at most.
const ATTEMPTS: usize = 5;

impl Gcm {
    /// Makes the system as the text of a system file says: all of it, or nothing. `prune`: removes also what
    /// the file's processes have and the file does not.
    ///
    /// # Errors
    /// ArgumentInvalid for a text that is no system file; otherwise as [`Gcm::execute`].
    pub async fn apply_system(&self, text: &str, prune: bool, options: ExecuteOptions) -> Answer {
        let (file, deadline) = (parsed("Apply", text)?, options.until());
        let hash = audit::hash_of(|hashing| {
            // The hash takes everything.
            let _ = write!(hashing, "{prune} {text}");
        });
        let by = Asked {
            identity: options.identity.clone(),
            request_id: options.request_id.clone(),
            hash,
            // Until it is known which requests that makes.
            text: format!(r#"{{"apply":{{"bytes":{},"prune":{prune}}}}}"#, text.len()),
        };
        self.once(hash, &options, deadline, self.becomes(&file, prune, &options, by, deadline)).await
    }

    async fn becomes(
        &self,
        file: &SystemFile,
        prune: bool,
        options: &ExecuteOptions,
        by: Asked,
        deadline: Instant,
    ) -> Answer {
        // One request, however often it is compared.
        let (mut attempts, since) = (0, self.inner.claims.arrive());
        loop {
            let graph = self.graph();
            let compared = file.difference(&graph, &self.held(), prune);
            let Difference { requests, left, refused, .. } = match compared {
                Ok(compared) => compared,
                Err(refusal) => return self.put_down(options, &by, Err(refusal)).await,
            };
            if let Some(refusal) = refused {
                return self.put_down(options, &by, Err(refusal)).await;
            }
            let compared = ExecuteOptions {
                expected_revision: options.expected_revision.or(Some(graph.revision)),
                ..options.clone()
            };
            let asked = Asked { text: audit::asked(&requests), ..by.clone() };
            attempts += 1;
            // A file may do no more than stop what it does not name.
            let is_changed = self.change(&requests, &compared, &asked, (since, deadline)).await;
            match is_changed {
                // One request, one record: of the last comparison.
                Err(Refusal::RevisionConflict { .. })
                    if options.expected_revision.is_none() && attempts < ATTEMPTS => {}
                changed => {
                    let answer = self.put_down(options, &asked, changed).await;
                    return answer.map(|done| Executed { left, ..done });
                }
            }
        }
    }

    fn held(&self) -> BTreeSet<ComponentId> {
        self.inner.holds.lock().all()
    }

    /// Compares the system with the text of a system file; returns the revision, too.
    ///
    /// # Errors
    /// ArgumentInvalid for a text that is no system file; the refusal of a component of it.
    pub fn compare(&self, text: &str) -> Result<(u64, Difference), Refusal> {
        let (file, graph) = (parsed("Compare", text)?, self.graph());
        Ok((graph.revision, file.difference(&graph, &self.held(), true)?))
    }

    /// Returns the text of a file in `folder` that makes the system again, what it does not say, and the
    /// revision.
    pub fn save(
        &self,
        folder: &Path,
        plugins: &BTreeMap<Name, BTreeSet<PathBuf>>,
    ) -> (u64, String, Vec<String>) {
        let graph = self.graph();
        let running = Running { graph: &graph, held: &self.held(), plugins };
        let (picture, notes) = running.picture(folder);
        (graph.revision, picture.text(), notes)
    }
}

fn parsed(what: &str, text: &str) -> Result<SystemFile, Refusal> {
    SystemFile::parse("system", text.to_owned()).map_err(|problem| Refusal::ArgumentInvalid {
        what: what.to_owned(),
        why: format!("{problem}: {}", problem.help),
        field: "system".to_owned(),
    })
}
