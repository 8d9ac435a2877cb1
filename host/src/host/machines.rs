//! The way by which other machines know a process, and reach it.

use std::path::PathBuf;
use std::sync::Arc;

use trocar_net::{Identity, Revoked};

use super::HostError;
use crate::control::{Dialler, Secured};

/// The way by which other machines know a process, and reach it; by default they do not.
#[derive(Clone, Debug, Default)]
pub struct Machines {
    /// File of its identity, which `trocar ca issue` made.
    pub identity: Option<PathBuf>,
    /// Address at which other machines reach it; port 0 takes a free one.
    pub listen: Option<String>,
    /// File of the certificates that are believed no more; it is looked at again and again.
    pub revoked: Option<PathBuf>,
}

impl Machines {
    /// Returns the way to others, and what it listens with.
    ///
    /// # Errors
    /// A file is missing or not what it should be, or an address lacks an identity.
    pub(super) fn open(&self) -> Result<(Dialler, Option<Secured>), HostError> {
        let unusable = |because: String| HostError::Identity { because };
        let Some(path) = &self.identity else {
            return match &self.listen {
                Some(listen) => Err(unusable(format!(
                    "{listen} can be reached from other machines, and this process has no identity to show them"
                ))),
                None if self.revoked.is_some() => Err(unusable(
                    "a list of revoked certificates is named, and no identity: nobody shows this process any"
                        .into(),
                )),
                None => Ok((Dialler::local(), None)),
            };
        };
        let identity = Identity::read(path).map_err(|e| unusable(e.to_string()))?;
        let identity = Arc::new(identity);
        let revoked = self.revoked.as_deref().map(Revoked::read).transpose().map_err(unusable)?.map(Arc::new);
        let dialler = Dialler::new(identity.clone(), revoked.clone());
        let secured = self.listen.clone().map(|listen| Secured { listen, identity, revoked });
        Ok((dialler, secured))
    }
}
