// Judges the histories of sessions: could each have been, with every call done at one moment between its begin and end?
//
//	judge HISTORY [SECONDS]
//
// HISTORY holds one call a line, as JSON (tests/e2e/histories.py). The checker is porcupine; here is only what a
// session is: a row of frames that grows at its end, under indices without gaps, and never changes. Ends with 0 if all
// sessions could have been, with 1 if one could not, with 2 if one was not decided in so many seconds (60).
package main

import (
	"bufio"
	"encoding/json"
	"fmt"
	"math"
	"os"
	"sort"
	"strconv"
	"time"

	"github.com/anishathalye/porcupine"
)

// A call: what was asked, and what came back. Without an answer it may have been done at any time since, or never.
type call struct {
	Session string `json:"session"`
	Client  int    `json:"client"`
	Kind    string `json:"kind"` // put, post, get, by-key, count
	Index   int    `json:"index"`
	Key     string `json:"key"`
	Body    string `json:"body"` // SHA-256 of the file
	Begin   int64  `json:"begin"`
	End     int64  `json:"end"`
	Result  string `json:"result"` // stored, absent, conflict, counted, unknown
	At      int    `json:"at"`     // index that was answered, or how many frames were counted
	Answer  string `json:"answer"` // digest of the estimate
	Repeats bool   `json:"repeats"`
}

// A frame as a session holds it. Of one that nobody had an answer of, the answer is empty until it is read.
type frame struct{ body, key, answer string }

type session struct{ frames []frame }

func (s session) with(f frame) session {
	return session{append(s.frames[:len(s.frames):len(s.frames)], f)}
}

// holds tells whether frame i is there with this answer, and the session in which it has it.
func (s session) holds(i int, answer string) (bool, session) {
	if i >= len(s.frames) {
		return false, s
	}
	if known := s.frames[i].answer; known != "" {
		return known == answer, s
	}
	frames := append([]frame(nil), s.frames...)
	frames[i].answer = answer
	return true, session{frames}
}

func (s session) under(key string) int {
	for i, f := range s.frames {
		if f.key == key {
			return i
		}
	}
	return -1
}

// store is a frame that a client wants stored: at an index of its own, or the next under a key.
func (s session) store(c call) (bool, session) {
	at, there := c.Index, c.Index < len(s.frames)
	if c.Kind == "post" {
		at = s.under(c.Key)
		there = at >= 0
		if !there {
			at = len(s.frames)
		}
	}
	next := at == len(s.frames)
	switch {
	case c.Result == "conflict":
		return there && s.frames[at].body == c.Answer && c.Answer != c.Body, s
	case c.Result == "unknown" && next:
		return true, s.with(frame{c.Body, c.Key, ""})
	case c.Result == "unknown":
		return true, s
	case c.At != at:
		return false, s
	case next:
		return true, s.with(frame{c.Body, c.Key, c.Answer})
	case there && c.Repeats && s.frames[at].body == c.Body:
		return s.holds(at, c.Answer)
	}
	return false, s
}

func step(state, input, _ interface{}) (bool, interface{}) {
	s, c := state.(session), input.(call)
	at := c.Index
	switch c.Kind {
	case "put", "post":
		return pair(s.store(c))
	case "count":
		return len(s.frames) == c.At, s
	case "by-key":
		at = s.under(c.Key)
	}
	if c.Result == "absent" {
		return at < 0 || at >= len(s.frames), s
	}
	if at < 0 || at != c.At {
		return false, s
	}
	return pair(s.holds(at, c.Answer))
}

func pair(ok bool, s session) (bool, interface{}) { return ok, s }

func equal(one, other interface{}) bool {
	a, b := one.(session).frames, other.(session).frames
	if len(a) != len(b) {
		return false
	}
	for i := len(a) - 1; i >= 0; i-- { // histories differ at their end
		if a[i] != b[i] {
			return false
		}
	}
	return true
}

func read(path string) (map[string][]porcupine.Operation, error) {
	file, err := os.Open(path)
	if err != nil {
		return nil, err
	}
	defer file.Close()
	found := map[string][]porcupine.Operation{}
	lines := bufio.NewScanner(file)
	for lines.Scan() {
		var c call
		if err := json.Unmarshal(lines.Bytes(), &c); err != nil {
			return nil, err
		}
		end := c.End
		if c.Result == "unknown" {
			end = math.MaxInt64
		}
		one := porcupine.Operation{ClientId: c.Client, Input: c, Call: c.Begin, Return: end}
		found[c.Session] = append(found[c.Session], one)
	}
	return found, lines.Err()
}

func main() {
	limit := time.Minute
	if len(os.Args) > 2 {
		seconds, err := strconv.Atoi(os.Args[2])
		exitOn(err)
		limit = time.Duration(seconds) * time.Second
	}
	histories, err := read(os.Args[1])
	exitOn(err)
	model := porcupine.Model{Init: func() interface{} { return session{} }, Step: step, Equal: equal}
	verdicts := map[porcupine.CheckResult][]string{}
	calls := 0
	for name, history := range histories {
		verdict := porcupine.CheckOperationsTimeout(model, history, limit)
		verdicts[verdict] = append(verdicts[verdict], name)
		calls += len(history)
	}
	illegal, unknown := verdicts[porcupine.Illegal], verdicts[porcupine.Unknown]
	sort.Strings(illegal)
	sort.Strings(unknown)
	told, _ := json.Marshal(map[string]interface{}{
		"sessions": len(histories), "calls": calls, "impossible": append([]string{}, illegal...),
		"undecided": append([]string{}, unknown...),
	})
	fmt.Println(string(told))
	if len(illegal) > 0 {
		os.Exit(1)
	}
	if len(unknown) > 0 {
		os.Exit(2)
	}
}

func exitOn(err error) {
	if err != nil {
		fmt.Fprintln(os.Stderr, err)
		os.Exit(3)
	}
}
