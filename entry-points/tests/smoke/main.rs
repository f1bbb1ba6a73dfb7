//! Every entry point with random bytes and with mutations of valid inputs, on a stable compiler.
//!
//! `TOMBOLO_FUZZ_ROUNDS` sets the rounds of a cheap entry point, `TOMBOLO_FUZZ_SEED` selects other
//! inputs. A failure prints the bytes; `cargo fuzz` in the package `fuzz` searches by coverage.

mod mutation;

use entry_points::{ALL, EntryPoint};
use mutation::Mutations;
use protocol::chunk_codec::{KIND_EXACT, KIND_QUANTISED, KIND_REFINED};
use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Rounds of an entry point of cost 1.
const ROUNDS: u64 = 6000;

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name}: `{text}`")))
}

/// Runs an entry point; returns the accepted inputs, or the bytes of the first panic.
fn search(entry: &EntryPoint, rounds: u64, seed: u64) -> Result<u64, Vec<u8>> {
    let mut mutations = Mutations::new((entry.seeds)(), seed);
    let mut accepted = 0;
    for _ in 0..rounds {
        let input = mutations.next_input();
        match catch_unwind(AssertUnwindSafe(|| (entry.run)(&input))) {
            Ok(is_accepted) => accepted += u64::from(is_accepted),
            Err(_) => return Err(input),
        }
    }
    Ok(accepted)
}

#[test]
fn valid_inputs_are_accepted() {
    for entry in ALL {
        let seeds = (entry.seeds)();
        let accepted = seeds.iter().filter(|seed| (entry.run)(seed)).count();
        assert!(2 * accepted > seeds.len(), "{}: {accepted} of {}", entry.name, seeds.len());
    }
}

#[test]
fn no_input_violates_an_invariant() {
    let (rounds, seed) = (number("TOMBOLO_FUZZ_ROUNDS", ROUNDS), number("TOMBOLO_FUZZ_SEED", 1));
    for entry in ALL {
        let rounds = rounds / u64::from(entry.cost);
        match search(&entry, rounds, seed) {
            Ok(accepted) => println!("{}: {rounds} inputs, {accepted} accepted", entry.name),
            Err(input) => {
                let hex: String = input.iter().map(|byte| format!("{byte:02x}")).collect();
                panic!("{}, seed {seed}: {hex}", entry.name);
            }
        }
    }
}

type Read = fn(&[u8], bool) -> Vec<Vec<u8>>;
type Seeds = fn() -> Vec<Vec<u8>>;

/// Chunk frames among mutated inputs that decoders read behind the digest, by kind. Frames of the
/// valid inputs do not count.
fn read_frames(read: Read, seeds: Vec<Vec<u8>>, reseals: bool, rounds: usize) -> [usize; 4] {
    let valid: HashSet<_> = seeds.iter().flat_map(|seed| read(seed, reseals)).collect();
    let mut mutations = Mutations::new(seeds, 1);
    let mut counts = [0; 4];
    let frames = (0..rounds).flat_map(|_| read(&mutations.next_input(), reseals));
    for frame in frames.filter(|frame| !valid.contains(frame)) {
        counts[usize::from(frame[6])] += 1;
    }
    counts
}

/// The control: the same inputs with the digests that they came with. Then no decoder reads a
/// changed byte behind the digest.
#[test]
fn mutated_chunks_of_every_kind_are_read_behind_the_digest() {
    let points: [(&str, Read, Seeds); 2] = [
        ("chunk", entry_points::chunk::read, entry_points::chunk::seeds),
        ("client_session", entry_points::client_session::read, entry_points::client_session::seeds),
    ];
    let kinds = [KIND_EXACT, KIND_QUANTISED, KIND_REFINED].map(usize::from);
    for (name, read, seeds) in points {
        let [raw, resealed] = [false, true].map(|reseals| read_frames(read, seeds(), reseals, 400));
        println!("{name}: {resealed:?} frames of each kind were read, {raw:?} without their digests");
        assert!(kinds.iter().all(|kind| resealed[*kind] >= 10), "{name}: {resealed:?}");
        assert_eq!(raw, [0; 4], "{name}");
    }
}

/// The control: an entry point that fails behind its first checks.
#[test]
fn a_planted_panic_is_found() {
    let planted = EntryPoint {
        name: "planted",
        run: |bytes| {
            let is_accepted = entry_points::control::run(bytes);
            assert!(!(bytes.len() > 60 && bytes.starts_with(b"TMBM") && bytes[10] > 200));
            is_accepted
        },
        seeds: entry_points::control::seeds,
        cost: 1,
    };
    let input = search(&planted, ROUNDS, 1).expect_err("the panic is not found");
    assert!(input.starts_with(b"TMBM"), "{input:02x?}");
}

/// Each target of the package `fuzz` is one of these, and each of these has a target. One more is
/// the control, with a planted fault.
#[test]
fn every_entry_point_has_a_fuzz_target() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz");
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
    for entry in ALL {
        let source = std::fs::read_to_string(folder.join(format!("fuzz_targets/{}.rs", entry.name))).unwrap();
        assert!(source.contains(&format!("entry_points::{}::run", entry.name)), "{}", entry.name);
        assert!(manifest.contains(&format!("name = \"{}\"", entry.name)), "{}", entry.name);
    }
    let targets = std::fs::read_dir(folder.join("fuzz_targets")).unwrap().count();
    assert!(folder.join("fuzz_targets/planted.rs").is_file());
    assert_eq!(targets, ALL.len() + 1);
}
