//! Bytes as they come, in whatever pieces, cut into lines.
//!
//! Invariant: no more than `LONGEST` bytes are kept, whatever comes; the rest of a line that is longer is
//! passed over up to its end.

/// Longest line, bytes: as the largest datagram; 1024 numbers of all digits are in it.
pub(crate) const LONGEST: usize = 65_536;

/// The begin of a line that has not ended yet.
#[derive(Default)]
pub(crate) struct Pieces {
    begun: Vec<u8>,
    /// The line that comes has been refused.
    passing: bool,
}

#[derive(Debug, PartialEq)]
pub(crate) enum Piece<'a> {
    /// Without its end.
    Line(&'a [u8]),
    /// Told once of each; with its begin.
    TooLong(&'a [u8]),
    /// The source ended in the middle of it: it may have been cut inside of a number.
    Unfinished(&'a [u8]),
}

impl Pieces {
    /// Tells `to` of each line that ends in `bytes`.
    pub(crate) fn push(&mut self, bytes: &[u8], mut to: impl FnMut(Piece<'_>)) {
        let mut rest = bytes;
        while let Some(end) = rest.iter().position(|byte| *byte == b'\n') {
            self.take(&rest[..end], &mut to);
            rest = &rest[end + 1..];
            if !self.passing {
                to(Piece::Line(self.begun.strip_suffix(b"\r").unwrap_or(&self.begun)));
            }
            self.begun.clear();
            self.passing = false;
        }
        self.take(rest, &mut to);
    }

    /// A datagram ends here, and with it a line.
    pub(crate) fn end_of_datagram(&mut self, mut to: impl FnMut(Piece<'_>)) {
        if !self.begun.is_empty() || self.passing {
            self.push(b"\n", &mut to);
        }
    }

    /// Nothing more comes.
    pub(crate) fn end(&mut self, mut to: impl FnMut(Piece<'_>)) {
        if !self.begun.is_empty() && !self.passing {
            to(Piece::Unfinished(&self.begun));
        }
        self.begun.clear();
        self.passing = false;
    }

    fn take(&mut self, bytes: &[u8], to: &mut impl FnMut(Piece<'_>)) {
        if self.passing {
            return;
        }
        let room = LONGEST - self.begun.len();
        self.begun.extend_from_slice(&bytes[..bytes.len().min(room)]);
        if bytes.len() > room {
            self.passing = true;
            to(Piece::TooLong(&self.begun));
            self.begun.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn told(pieces: &mut Pieces, bytes: &[u8]) -> Vec<String> {
        let mut all = Vec::new();
        pieces.push(bytes, |piece| all.push(text(piece)));
        all
    }

    fn text(piece: Piece<'_>) -> String {
        match piece {
            Piece::Line(line) => format!("line {}", String::from_utf8_lossy(line)),
            Piece::TooLong(begin) => format!("too long {}", begin.len()),
            Piece::Unfinished(begin) => format!("unfinished {}", String::from_utf8_lossy(begin)),
        }
    }

    #[test]
    fn lines_are_whole_whatever_pieces_they_come_in() {
        let mut pieces = Pieces::default();
        assert!(told(&mut pieces, b"1,").is_empty());
        assert_eq!(told(&mut pieces, b"2\r\n\n3\n4"), ["line 1,2", "line ", "line 3"]);
        let mut rest = Vec::new();
        pieces.end_of_datagram(|piece| rest.push(text(piece)));
        pieces.end_of_datagram(|piece| rest.push(text(piece)));
        assert!(told(&mut pieces, b"12.3").is_empty());
        pieces.end(|piece| rest.push(text(piece)));
        assert_eq!(rest, ["line 4", "unfinished 12.3"]);
    }

    #[test]
    fn a_line_without_an_end_is_told_once_and_passed_over() {
        let mut pieces = Pieces::default();
        let flood = vec![b'x'; 1 << 20];
        assert_eq!(told(&mut pieces, &flood), ["too long 65536"]);
        assert!(told(&mut pieces, &flood).is_empty());
        assert_eq!(told(&mut pieces, b"x\n1\n"), ["line 1"]);
        let most = [&vec![b'y'; LONGEST][..], b"\n"].concat();
        assert_eq!(told(&mut pieces, &most).len(), 1);
        assert!(told(&mut pieces, &most)[0].starts_with("line y"));
    }

    proptest! {
        #[test]
        fn pieces_make_no_difference(bytes in proptest::collection::vec(prop_oneof![Just(b'\n'), any::<u8>()], 0..300),
                                     cuts in proptest::collection::vec(0usize..300, 0..8)) {
            let at_once = told(&mut Pieces::default(), &bytes);
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(bytes.len())).collect();
            cuts.extend([0, bytes.len()]);
            cuts.sort_unstable();
            let mut pieces = Pieces::default();
            let apart: Vec<String> =
                cuts.windows(2).flat_map(|w| told(&mut pieces, &bytes[w[0]..w[1]])).collect();
            prop_assert_eq!(at_once, apart);
        }
    }
}
