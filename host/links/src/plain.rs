//! A sentence of another process, made fit to be shown.

/// Most characters of a sentence another process says.
const SENTENCE: usize = 300;

/// Makes a sentence of another process fit for a log or a person: one line of bounded length.
pub(crate) fn plain(said: &str) -> String {
    let line = said.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c });
    let mut text: String = line.take(SENTENCE).collect();
    if said.chars().nth(SENTENCE).is_some() {
        text.push('…');
    }
    text
}
