//! The rest of the whole cross of ways and cases: whatever the suite `conformance` leaves out.
//!
//! Promise: that of `conformance`, for every case in every way. Together the two suites play each case once
//! in each way (a test of `conformance` counts them); this one is not part of what each change has to pass.

ways! { modules (Cross) }
