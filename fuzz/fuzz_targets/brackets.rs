//! Which photographs are exposures of one view, by names, times and exposures: each photograph is
//! in one view, whatever it is called.
//!
//! A line is a photograph: camera, time, stops and seconds as a byte each (255: not known), then
//! its name.

#![no_main]

use libfuzzer_sys::fuzz_target;
use luxel_capture::{BracketRule, Shot, find_brackets};

fuzz_target!(|bytes: &[u8]| {
    let shots: Vec<Shot> = bytes
        .split(|b| *b == b'\n')
        .filter_map(|line| {
            let ([camera, time, stops, seconds], name) = line.split_first_chunk::<4>()?;
            let known = |byte: u8| (byte != 255).then_some(f64::from(byte));
            Some(Shot {
                name: String::from_utf8_lossy(name).into_owned(),
                camera: usize::from(camera % 4),
                time_s: known(*time).map(|t| 0.5 * t),
                stops: known(*stops).map(|s| s / 6.0 - 20.0),
                seconds: known(*seconds).map(|s| s / 20.0),
            })
        })
        .collect();
    for rule in [BracketRule::Auto, BracketRule::Off, BracketRule::Names, BracketRule::Count(3)] {
        let Ok(found) = find_brackets(&shots, rule) else { continue };
        let mut all = found.views.concat();
        all.sort_unstable();
        assert_eq!(all, (0..shots.len()).collect::<Vec<_>>());
        assert!(found.views.iter().all(|view| !view.is_empty()));
        assert!(
            found.views.iter().all(|view| view.iter().all(|i| shots[*i].camera == shots[view[0]].camera)) || rule == BracketRule::Count(3)
        );
    }
});
