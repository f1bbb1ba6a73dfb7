//! Prints one digest per kernel of this machine; all must be equal.
//!
//! Run: `cargo run -p tombolo-terrain --example kernels`. The vector code through an interpreter
//! that checks every access (minutes):
//! `RUSTFLAGS="-C target-feature=+avx2" cargo +nightly miri run -p tombolo-terrain --example
//! kernels`

mod digest;

use std::process::ExitCode;
use terrain::Kernel;

fn main() -> ExitCode {
    let digests: Vec<u64> = Kernel::available()
        .map(|kernel| {
            let digest = digest::digest(kernel);
            println!("{kernel} {digest:016x}");
            digest
        })
        .collect();
    if digests.windows(2).all(|pair| pair[0] == pair[1]) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
