//! The GCM that leads, among the addresses of several.
//!
//! Invariant: each address is asked once in a search, those that others name too, so that it ends whatever
//! they say of each other.

use std::collections::{BTreeSet, VecDeque};
use std::error::Error;
use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::StatusExt;
use trocar_proto::v1::TellRequest;
use trocar_proto::v1::attach_service_client::AttachServiceClient;

use super::caller::Tokened;
use super::dial::{Dialler, is_secured};
use crate::runtime_dir::Door;

/// Addresses that are asked in one search, at most.
const MOST: usize = 16;

/// A GCM that answers for its system, or the only program that was asked.
pub struct Leader {
    /// `HOST:PORT`, with `https://` in front where certificates are shown.
    pub addr: String,
    pub channel: Tokened,
    /// Its term; 0: it has told none, since it is a host of another GCM.
    pub term: u64,
}

/// Reads the addresses of one or of several GCMs, with commas between them.
pub fn addresses(text: &str) -> Vec<String> {
    let each = text.split(',').map(|one| one.trim().trim_start_matches("http://").trim_end_matches('/'));
    each.filter(|one| !one.is_empty()).map(str::to_owned).collect()
}

/// Returns the GCM that leads. Each address has `within` to answer.
///
/// # Errors
/// Nobody leads: what each address said.
pub async fn find_leader(
    dialler: &Dialler,
    addrs: &[String],
    door: Option<Door>,
    within: Duration,
) -> Result<Leader, Vec<(String, String)>> {
    let mut queue: VecDeque<String> = addrs.iter().cloned().collect();
    let (mut asked, mut said) = (BTreeSet::new(), Vec::new());
    while let Some(addr) = queue.pop_front() {
        if asked.len() >= MOST || !asked.insert(addr.clone()) {
            continue;
        }
        let silent = || Asked::Silent(format!("it did not answer within {}", spelled(within)));
        let told = tokio::time::timeout(within, ask(dialler, &addr, door, within))
            .await
            .unwrap_or_else(|_| silent());
        match told {
            Asked::Leads(channel, term) => return Ok(Leader { addr, channel, term }),
            // One that shows certificates leads nobody to where none are shown.
            Asked::Names(leader, why) if is_secured(&addr) && !is_secured(&leader) => {
                said.push((addr, format!("{why}; where no certificates are shown it is not asked")));
            }
            Asked::Names(leader, why) => {
                queue.push_front(leader);
                said.push((addr, why));
            }
            Asked::Silent(why) => said.push((addr, why)),
        }
    }
    Err(said)
}

fn spelled(within: Duration) -> String {
    match within.subsec_millis() {
        0 => format!("{} s", within.as_secs()),
        _ => format!("{} ms", within.as_millis()),
    }
}

/// Answer of an address.
enum Asked {
    Leads(Tokened, u64),
    /// Another leads.
    Names(String, String),
    Silent(String),
}

async fn ask(dialler: &Dialler, addr: &str, door: Option<Door>, within: Duration) -> Asked {
    let channel = match dialler.dial(addr, door, within).await {
        Ok(channel) => channel,
        Err(e) => return Asked::Silent(innermost(&*e)),
    };
    match AttachServiceClient::new(channel.clone()).tell(TellRequest::default()).await {
        Ok(told) => Asked::Leads(channel, told.into_inner().term),
        Err(refused) if refused.code() == Code::Unimplemented => Asked::Leads(channel, 0),
        Err(refused) => match leader_named(&refused) {
            Some(leader) if !leader.is_empty() => Asked::Names(leader, refused.message().to_owned()),
            _ => Asked::Silent(refused.message().to_owned()),
        },
    }
}

/// Returns the address of the GCM that leads, by the answer of one that does not; empty where it does not
/// know.
pub(super) fn leader_named(refused: &Status) -> Option<String> {
    let details = refused.get_error_details();
    let info = details.error_info().filter(|info| info.reason == "NOT_LEADER")?;
    Some(info.metadata.get("leader").cloned().unwrap_or_default())
}

/// The innermost cause: the outer ones say "transport error".
pub(super) fn innermost(e: &(dyn Error + 'static)) -> String {
    let mut inner = e;
    while let Some(source) = inner.source() {
        inner = source;
    }
    inner.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_with_or_without_a_scheme() {
        assert_eq!(addresses("127.0.0.1:1"), ["127.0.0.1:1"]);
        assert_eq!(addresses("http://a:1/, b:2,,"), ["a:1", "b:2"]);
        assert_eq!(addresses("https://a:1/,b:2"), ["https://a:1", "b:2"], "certificates are shown there");
        assert!(addresses("").is_empty());
    }
}
