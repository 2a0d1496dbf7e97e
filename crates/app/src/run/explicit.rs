//! The options that a user gave, as distinct from defaults.

/// Names of the options that were given explicitly, in the order of giving: `max_splats`,
/// `eval_every`.
///
/// ```
/// let explicit: luxel_app::run::ExplicitArgs = ["seed", "downscale"].into_iter().collect();
/// assert!(explicit.contains("seed") && !explicit.contains("mu"));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExplicitArgs(Vec<String>);

impl ExplicitArgs {
    /// Returns whether the option was given.
    pub fn contains(&self, option: &str) -> bool {
        self.0.iter().any(|given| given == option)
    }

    /// Returns the options, in order.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }

    /// Returns the options but for one.
    #[must_use]
    pub fn without(&self, option: &str) -> Self {
        self.iter().filter(|given| *given != option).collect()
    }
}

impl<S: Into<String>> FromIterator<S> for ExplicitArgs {
    fn from_iter<I: IntoIterator<Item = S>>(options: I) -> Self {
        Self(options.into_iter().map(Into::into).collect())
    }
}
