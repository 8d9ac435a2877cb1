//! The place of a journal in etcd, as people spell it: `etcd://HOST:PORT[,HOST:PORT...]/PREFIX`.
//!
//! Invariant: parsed once, strictly; what is not understood is refused with what is wrong with it.

use std::fmt;
use std::str::FromStr;

const SCHEME: &str = "etcd://";

/// Members of an etcd cluster, and the prefix of all keys of one system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EtcdPlace {
    endpoints: Vec<String>,
    prefix: String,
}

/// A place that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlaceError {
    asked: String,
    why: String,
}

impl fmt::Display for PlaceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{}\" is not a place for a journal: {}", self.asked, self.why)
    }
}

impl std::error::Error for PlaceError {}

impl EtcdPlace {
    /// Members, each `HOST:PORT`.
    pub fn endpoints(&self) -> &[String] {
        &self.endpoints
    }

    /// Prefix of all keys, without a slash at its ends.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }
}

impl fmt::Display for EtcdPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{SCHEME}{}/{}", self.endpoints.join(","), self.prefix)
    }
}

impl FromStr for EtcdPlace {
    type Err = PlaceError;

    fn from_str(asked: &str) -> Result<Self, PlaceError> {
        parse(asked).map_err(|why| PlaceError { asked: asked.to_owned(), why })
    }
}

fn parse(asked: &str) -> Result<EtcdPlace, String> {
    let rest = asked
        .strip_prefix(SCHEME)
        .ok_or("it has to begin with etcd:// (a journal in a file is where --state says, without --store)")?;
    let (members, prefix) = rest.split_once('/').ok_or(
        "it has no prefix: give a name for the system behind the members, for example etcd://127.0.0.1:2379/lab7",
    )?;
    let endpoints = members.split(',').map(endpoint).collect::<Result<Vec<_>, _>>()?;
    if let Some(twice) = endpoints.iter().enumerate().find(|(at, one)| endpoints[..*at].contains(one)) {
        return Err(format!("{} is there twice", twice.1));
    }
    if prefix.is_empty() {
        return Err("the prefix is empty: give a name for the system, for example lab7".into());
    }
    for part in prefix.split('/') {
        if part.is_empty() {
            return Err(format!("the prefix \"{prefix}\" has an empty part"));
        }
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if let Some(other) = part.chars().find(|c| !is_plain(*c)) {
            return Err(format!(
                "the prefix \"{prefix}\" has {other:?} in it: take letters, digits, \"-\", \"_\", \".\", with \"/\" between parts"
            ));
        }
    }
    Ok(EtcdPlace { endpoints, prefix: prefix.to_owned() })
}

fn endpoint(text: &str) -> Result<String, String> {
    match text.is_empty() {
        true => Err("a member is empty: give each as HOST:PORT, with commas between them".into()),
        false => host_and_port(text),
    }
}

/// Reads an address as people spell it: HOST:PORT, or [ADDRESS]:PORT for IPv6.
///
/// # Errors
/// It is none: the text says why.
pub fn host_and_port(text: &str) -> Result<String, String> {
    let (host, port) = text.rsplit_once(':').ok_or_else(|| format!("{text} has no port: give HOST:PORT"))?;
    let inner = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | ':');
    let is_bare_v6 = host.contains(':') && inner == host;
    if inner.is_empty() || is_bare_v6 || !inner.chars().all(is_plain) {
        return Err(format!(
            "{text} has no host that can be read: give HOST:PORT, or [ADDRESS]:PORT for IPv6"
        ));
    }
    match port.parse::<u16>() {
        Ok(1..) => Ok(text.to_owned()),
        _ => Err(format!("{text} has a port that is not a number from 1 to 65535")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn a_place_is_read_and_written_the_same() {
        for text in ["etcd://127.0.0.1:2379/lab7", "etcd://a:1,[::1]:2,b.c:3/lab-7/left_2.x"] {
            let place: EtcdPlace = text.parse().unwrap();
            assert_eq!(place.to_string(), text);
        }
        let place: EtcdPlace = "etcd://a:1,b:2/x/y".parse().unwrap();
        assert_eq!((place.endpoints(), place.prefix()), (&["a:1".to_owned(), "b:2".to_owned()][..], "x/y"));
    }

    #[test]
    fn what_is_wrong_with_a_place_is_said() {
        for (text, why) in [
            ("redb:///tmp", "begin with etcd://"),
            ("etcd://127.0.0.1:2379", "no prefix"),
            ("etcd://127.0.0.1:2379/", "prefix is empty"),
            ("etcd:///lab7", "a member is empty"),
            ("etcd://a:1,/lab7", "a member is empty"),
            ("etcd://127.0.0.1/lab7", "has no port"),
            ("etcd://a:0/lab7", "not a number from 1 to 65535"),
            ("etcd://a:70000/lab7", "not a number from 1 to 65535"),
            ("etcd://:1/lab7", "no host"),
            ("etcd://::1:1/lab7", "no host"),
            ("etcd://a b:1/lab7", "no host"),
            ("etcd://a:1,a:1/lab7", "a:1 is there twice"),
            ("etcd://a:1/lab//7", "an empty part"),
            ("etcd://a:1/lab7/", "an empty part"),
            ("etcd://a:1/läb", "'ä'"),
        ] {
            let refused = text.parse::<EtcdPlace>().unwrap_err().to_string();
            assert!(refused.contains(why) && refused.contains(text), "{text}: {refused}");
        }
    }
}
