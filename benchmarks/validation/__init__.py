"""Published figures of other people, computed again through the public interface."""
