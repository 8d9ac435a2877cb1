//! The first words of a running demo: where it is seen, and what to try.

use crate::{hosting, run, session};

pub(super) struct Head {
    pub(super) title: String,
    pub(super) addr: String,
    /// A read command to call.
    pub(super) command: String,
}

impl Head {
    /// Returns one thing a line, for a person who reads from the top.
    pub(super) fn lines(&self) -> String {
        let picture = self.picture();
        let hints = run::hints(&self.addr, Some(&self.command));
        format!("{}\n  the surgeon's picture: {picture}\n{hints}\n", self.title)
    }

    /// Returns as few lines as 80 columns allow: they stay in view.
    pub(super) fn for_a_screen(&self) -> String {
        let addr = &self.addr;
        let viewer = hosting::viewer(addr);
        let picture = self.picture();
        let gcm = if addr == session::DEFAULT_GCM { String::new() } else { format!(" --gcm {addr}") };
        format!(
            "{}\n  picture {picture}  viewer {viewer}  q ends\n  trocar ls{gcm}\n  grpcurl -plaintext {addr} trocar.v1.GcmService/List\n{}",
            self.title,
            run::invocation(addr, &self.command)
        )
    }

    /// Address of the surgeon's picture, the one it has.
    fn picture(&self) -> String {
        format!("{}video", hosting::viewer(&self.addr))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_in_view_has_80_columns_and_can_be_pasted() {
        let head = Head {
            title: "trocar demo bscan is running in 3 processes, GCM 127.0.0.1:50551".into(),
            addr: "127.0.0.1:50551".into(),
            command: "robot/bscan/scan/progress".into(),
        };
        let text = head.for_a_screen();
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{line}");
        }
        let pasted = text.replace("\\\n", "");
        assert!(
            pasted.contains("grpcurl -plaintext -d '{\"path\":\"robot/bscan/scan/progress\"}'"),
            "{text}"
        );
        assert!(text.lines().count() <= 6, "{text}");
    }
}
