//! Frames of a fake component: it makes numbered ones, and passes on those of an input.
//!
//! Invariant: the header of a frame is one u64; its bytes do not matter.

use trocar_plugin_api::abi::{EXECUTED, IN_SAMPLE, Loan, Outcome, SampleView};

use super::Own;

impl Own {
    /// Makes a frame with this number; EXHAUSTED where its pool has no slot.
    pub(crate) fn give(&self, output: usize, number: u64) -> Outcome {
        let mut loan = Loan::EMPTY;
        // SAFETY: the tests' classes have that output, of frames with a header of u64, and are bound before
        // they run.
        unsafe {
            let slot = *(*self.ports).outputs.add(output);
            let lent = ((*slot).loan)((*slot).ctx, &raw mut loan);
            if lent != EXECUTED {
                return lent;
            }
            loan.header.cast::<u64>().write(number);
            ((*slot).commit)((*slot).ctx, &raw mut loan, 0, 0)
        }
    }

    /// Passes the next frame of an input on and lets go of it; returns its number.
    pub(crate) fn pass(&self, input: usize, output: usize) -> Option<u64> {
        let mut view = SampleView::EMPTY;
        // SAFETY: the tests' classes have these ports, of frames with a header of u64, and are bound before
        // they run.
        unsafe {
            let (from, to) = (*(*self.ports).inputs.add(input), *(*self.ports).outputs.add(output));
            if ((*from).next)((*from).ctx, &raw mut view) != IN_SAMPLE {
                return None;
            }
            let number = view.header.cast::<u64>().read();
            ((*to).forward)((*to).ctx, &raw const view, view.stamp_ns);
            ((*from).release)((*from).ctx);
            Some(number)
        }
    }
}
