//! The starts of worlds as they are known: a viewer, a load test and a person who names a world
//! begin at the same place, whatever the program.

use terrain::Land;
use terrain::hash::mix;
use terrain::start::Start;

const STARTS: [Start; 4] = [
    Start { x: -741_376, z: 69_632, inland: (32_610, -3212) },
    Start { x: -405_504, z: 491_520, inland: (20_788, -25_330) },
    Start { x: -421_888, z: -348_160, inland: (25_330, 20_788) },
    Start { x: 405_504, z: -495_616, inland: (-20_788, 25_330) },
];

/// A hash over the starts of the worlds 0 to 63.
const HASH: u32 = 0x7000_138f;

#[test]
fn worlds_begin_where_they_are_known_to_begin() {
    for (seed, start) in STARTS.into_iter().enumerate() {
        assert_eq!(Land::new(seed as u64).start(), start, "world {seed}");
    }
    let hash = (0..64).fold(0, |hash, seed| {
        let Start { x, z, inland } = Land::new(seed).start();
        [x, z, inland.0, inland.1].into_iter().fold(hash, |hash, word| mix(hash ^ word as u32))
    });
    assert_eq!(hash, HASH, "{hash:#x}");
}
