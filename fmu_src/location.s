# fmi2Instantiate(name, type, guid, location, callbacks, visible, logging): decode the escapes %XX of `location`, then call the
# original. For x86-64 with the calling convention of System V. `vpp_fmu.export.location` has the machine code of this file.
	.globl	fmi2Instantiate
fmi2Instantiate:
	endbr64
	push	%rbp
	mov	%rsp, %rbp
	push	%rbx
	test	%rcx, %rcx		# no location: nothing to decode
	jz	pass
	mov	%rcx, %r10
length:	cmpb	$0, (%r10)
	lea	1(%r10), %r10
	jne	length
	sub	%rcx, %r10		# its bytes with the final zero
	sub	%r10, %rsp		# room for as many on the stack
	mov	%rcx, %r10		# from here
	mov	%rsp, %rcx		# to the new argument
	mov	%rsp, %r11
copy:	mov	(%r10), %bl
	inc	%r10
	cmp	$'%', %bl
	jne	store
	mov	(%r10), %al
	call	digit
	jae	store			# no digit: the % stands for itself
	mov	%al, %bl
	mov	1(%r10), %al
	call	digit
	jae	sign
	shl	$4, %bl
	or	%al, %bl
	add	$2, %r10
	jmp	store
sign:	mov	$'%', %bl
store:	mov	%bl, (%r11)
	inc	%r11
	test	%bl, %bl
	jnz	copy
pass:	and	$-16, %rsp		# as every call wants it
	sub	$8, %rsp
	push	16(%rbp)		# logging
	call	original
	mov	-8(%rbp), %rbx
	leave
	ret

digit:	or	$0x20, %al		# lower case; digits remain
	sub	$'0', %al
	cmp	$10, %al
	jb	known
	sub	$'a' - '0' - 10, %al
	cmp	$10, %al
	jb	none
	cmp	$16, %al		# carry: a digit
known:	ret
none:	cmp	%al, %al		# no carry
	ret
	.equ	original, . 
