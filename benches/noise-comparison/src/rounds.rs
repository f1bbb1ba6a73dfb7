//! Interleaved timing: every round times every contender once, and only figures of the same round
//! are compared.
//!
//! The speed of a shared machine changes by tens of percent within seconds. Contenders timed one
//! after the other would be compared across such changes; contenders of one round share them. A
//! slice in which the scheduler took the core away is repeated, and the median over many rounds
//! removes other outliers.

use crate::disturbance;
use anyhow::{Result, ensure};
use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Time that one contender gets in one round, unless a single call takes longer. Below a
/// scheduler's time slice, so that most slices are not interrupted; long enough that reading the
/// clock does not count.
const SLICE: Duration = Duration::from_micros(1500);

/// Attempts to get a slice that other programs did not disturb.
const MAX_ATTEMPTS: usize = 6;

/// Low corner of a grid, in samples of 2 m.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corner {
    /// Samples east of the origin.
    pub x: i32,
    /// Samples south of the origin.
    pub z: i32,
}

impl Corner {
    /// Chunks along one side of the square that corners are taken from: up to 1.7 km from the
    /// origin on each axis, all of it on the home island or in its bays, so that nothing is timed
    /// over the open sea, where the land is flat and nearly free.
    const SIDE: i32 = 26;

    /// Number of different corners.
    pub const COUNT: usize = (Self::SIDE * Self::SIDE) as usize;

    /// A corner by number; neighbouring numbers are far apart.
    pub fn of(number: usize) -> Self {
        // 1,597 is prime to the count, so multiples of it visit every chunk before they repeat.
        let chunk = (number % Self::COUNT * 1597 % Self::COUNT) as i32;
        Self { x: (chunk % Self::SIDE - Self::SIDE / 2) * 64, z: (chunk / Self::SIDE - Self::SIDE / 2) * 64 }
    }
}

/// A function that is timed.
pub struct Contender<'a> {
    name: String,
    body: Box<dyn Body + 'a>,
    calls: usize,
}

trait Body {
    fn run(&mut self, corner: Corner);
    fn output(&self) -> Vec<f64>;
}

struct Filling<T, F> {
    buffer: Vec<T>,
    fill: F,
}

impl<T: Copy + Into<f64>, F: FnMut(Corner, &mut [T])> Body for Filling<T, F> {
    fn run(&mut self, corner: Corner) {
        (self.fill)(black_box(corner), black_box(&mut self.buffer));
        black_box(&self.buffer);
    }

    fn output(&self) -> Vec<f64> {
        self.buffer.iter().map(|value| (*value).into()).collect()
    }
}

impl<'a> Contender<'a> {
    /// A contender that fills a buffer of `len` values, allocated once, from another corner in each
    /// call.
    pub fn new<T: Copy + Default + Into<f64> + 'a>(
        name: impl Into<String>,
        len: usize,
        fill: impl FnMut(Corner, &mut [T]) + 'a,
    ) -> Self {
        let body = Box::new(Filling { buffer: vec![T::default(); len], fill });
        Self { name: name.into(), body, calls: 1 }
    }

    /// What it computes from a corner.
    pub fn output(&mut self, corner: Corner) -> Vec<f64> {
        self.body.run(corner);
        self.body.output()
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Rejects a contender without real output: constant, not finite, or independent of the corner.
    pub fn check(&mut self) -> Result<()> {
        let outputs = [0, 1].map(|number| self.output(Corner::of(number)));
        for output in &outputs {
            let (low, high) =
                output.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
            ensure!(
                output.iter().all(|value| value.is_finite()) && low < high,
                "{}: the output is constant or not finite, so its time means nothing",
                self.name
            );
        }
        ensure!(outputs[0] != outputs[1], "{}: the output does not depend on the position", self.name);
        Ok(())
    }

    /// Finds how many calls fill a slice, and warms code and buffers.
    fn calibrate(&mut self) {
        while self.slice(0).seconds < SLICE.as_secs_f64() / 2.0 {
            self.calls *= 2;
        }
    }

    /// One slice. One uncounted call before it brings code and buffers back into the caches.
    fn slice(&mut self, first: usize) -> Slice {
        self.body.run(Corner::of(first));
        let before = disturbance::ready_time();
        let began = Instant::now();
        for call in 1..=self.calls {
            self.body.run(Corner::of(first + call));
        }
        let elapsed = began.elapsed();
        let waited = disturbance::ready_time().saturating_sub(before);
        // Without the wait: a contender with long calls is interrupted in every slice and would
        // look slower.
        Slice { seconds: elapsed.saturating_sub(waited).as_secs_f64(), waited }
    }

    /// The first undisturbed slice; after [`MAX_ATTEMPTS`] the least disturbed one.
    fn undisturbed_slice(&mut self, first: usize) -> Slice {
        let mut best = self.slice(first);
        for _ in 1..MAX_ATTEMPTS {
            if !best.is_disturbed() {
                break;
            }
            let again = self.slice(first);
            if again.waited < best.waited {
                best = again;
            }
        }
        best
    }
}

/// Time with a core and time waiting for one, of a slice.
#[derive(Clone, Copy)]
struct Slice {
    seconds: f64,
    waited: Duration,
}

impl Slice {
    fn is_disturbed(self) -> bool {
        disturbance::is_disturbed(self.waited, self.seconds)
    }
}

/// Seconds per call of every contender in every round.
pub struct Times {
    rounds: usize,
    seconds: BTreeMap<String, Vec<f64>>,
}

/// Times the contenders. Also returns how many counted slices were disturbed.
pub fn run(contenders: &mut [Contender<'_>], rounds: usize) -> (Times, usize) {
    contenders.iter_mut().for_each(Contender::calibrate);
    let (mut times, mut disturbed) = (Times::of_rounds(rounds), 0);
    for round in 0..rounds {
        for turn in 0..contenders.len() {
            // A core may be slower after AVX-512 code; the rotation spreads that over all.
            let contender = &mut contenders[(turn + round) % contenders.len()];
            let slice = contender.undisturbed_slice(round * 131);
            disturbed += usize::from(slice.is_disturbed());
            times.add(&contender.name, slice.seconds / contender.calls as f64);
        }
    }
    (times, disturbed)
}

impl Times {
    /// No rounds yet; [`Times::add`] fills it.
    pub fn of_rounds(rounds: usize) -> Self {
        Self { rounds, seconds: BTreeMap::new() }
    }

    /// The next round's time of a contender.
    pub fn add(&mut self, name: &str, seconds: f64) {
        self.seconds.entry(name.into()).or_default().push(seconds);
    }

    /// A figure of every round and its spread; `figure` is given the times of one round by
    /// contender.
    ///
    /// # Panics
    /// If `figure` asks for a contender that was not timed.
    pub fn spread(&self, figure: impl Fn(&dyn Fn(&str) -> f64) -> f64) -> Spread {
        let figures = (0..self.rounds).map(|round| figure(&|name: &str| self.seconds[name][round]));
        Spread::of(figures.collect())
    }

    /// Time of `a` over time of `b`.
    pub fn ratio(&self, a: &str, b: &str) -> Spread {
        self.spread(|of| of(a) / of(b))
    }

    /// Median microseconds per call.
    pub fn microseconds(&self, name: &str) -> f64 {
        self.spread(|of| of(name)).median * 1e6
    }

    /// All contenders.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.seconds.keys().map(String::as_str)
    }
}

/// A figure over all rounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The median.
    pub median: f64,
    /// The smallest of all rounds.
    pub min: f64,
    /// The largest of all rounds.
    pub max: f64,
}

impl Spread {
    fn of(mut figures: Vec<f64>) -> Self {
        figures.sort_by(f64::total_cmp);
        let nothing = Self { median: f64::NAN, min: f64::NAN, max: f64::NAN };
        let (Some(min), Some(max)) = (figures.first(), figures.last()) else { return nothing };
        Self { median: figures[figures.len() / 2], min: *min, max: *max }
    }
}
